/**
 * The drawer: what the method saw and did at the chosen keyframe, step by step, and the same pictures on the map.
 *
 * The server draws the pictures; the last ones are kept.
 */
import { getJson, loadPicture } from "../api.js";
import { bullets, busy, iconButton, table } from "../controls.js";
import { el, fill, formatMetres, plural } from "../dom.js";
import { TurnedImage } from "../map/keyframe.js";
import { firstDetection, onResult, shown } from "../map/shown.js";
import { signIcon } from "../map/symbols.js";
import { openDialog, problemNote } from "../messages.js";
import { addShortcut } from "../shortcuts.js";
import { getState, setState, subscribe } from "../state.js";

/** The steps in their order, as in the paper's Fig. 2. */
const STEPS = [
  { layer: "bev", name: "BEV image", hint: "Cells of the bird’s eye view with enough road points." },
  { layer: "occupancy", name: "Road occupancy", hint: "Gaps closed, specks removed." },
  { layer: "centerline", name: "Centerline", hint: "Skeleton of the road without its spurs." },
  { layer: "candidates", name: "Candidates", hint: "Where the centerline branches." },
  { layer: "branches", name: "Branches", hint: "Lines along the branches; they meet in the intersection." },
  { layer: "all", name: "All together", hint: "Every step over the road." },
];
const OF_CANDIDATES = new Set(["candidates", "branches"]); // these pictures are empty where there is no candidate
const PAUSE_MS = 120; // while the slider moves, only the last keyframe is asked for

/** @param {HTMLElement} drawer */
export function mountDrawer(drawer) {
  /** @type {Set<string>} */
  const onMap = new Set(["occupancy", "centerline"]);
  /** @type {Map<string, any>} */
  const overlays = new Map();
  let opacity = 0.7;
  let stop = new AbortController();
  /** @type {ReturnType<typeof setTimeout>|undefined} */
  let timer;

  const title = el("h2");
  const note = el("p.small");
  const trouble = el("div");
  const seen = el("div");
  const rejected = el("div");
  const step = (/** @type {number} */ by) => {
    const row = shown.result?.frame.rows.get(getState().frame);
    const next = row === undefined ? null : shown.result?.keyframes[row + by];
    if (next) setState({ frame: next.properties.frame });
  };
  const widen = () => {
    drawer.classList.toggle("wide");
    shown.map?.invalidateSize();
  };
  const figures = STEPS.map(({ layer, name, hint }, number) => {
    const image = el("img.waiting", { alt: "" });
    const onChange = () => {
      onMap[box.checked ? "add" : "delete"](layer);
      void load();
    };
    const box = el("input", { type: "checkbox", checked: onMap.has(layer), onChange });
    const label = { title: `${hint} Click to enlarge.`, "aria-label": `Enlarge ${name}` };
    const enlarge = () => showLarge(name, hint, image.src);
    const isAll = layer === "all";
    const caption = el("span", el("b", isAll ? "" : `${number + 1} `), name);
    const choice = !isAll && el("label.key-row.quiet", { title: "Show it on the map" }, box, "on map");
    const nothing = el("span.nothing", { hidden: true }, "none");
    const button = el("button.picture", { ...label, onClick: enlarge }, image, nothing);
    return { layer, image, button, nothing, figure: el("figure", button, el("figcaption.spread", caption, choice)) };
  });
  const setOpacity = () => {
    opacity = Number(fade.value);
    for (const overlay of overlays.values()) overlay.setOpacity(opacity);
  };
  const range = { min: 0.1, max: 1, step: 0.05, value: opacity, "aria-label": "Opacity on the map" };
  const fade = el("input", { type: "range", ...range, onInput: setOpacity });
  const close = () => setState({ drawer: false });
  addShortcut("Escape", "Close the keyframe and the details", () => (close(), shown.map?.closePopup()), "Esc");
  const wider = iconButton("wide", "Wider", widen);
  wider.classList.add("widen");
  const buttons = el("div.row.tight", [
    iconButton("previous", "Previous keyframe", () => step(-1), "Previous keyframe (,)"),
    iconButton("next", "Next keyframe", () => step(1), "Next keyframe (.)"),
    wider,
    iconButton("close", "Close", () => close(), "Close (Esc)"),
  ]);
  fill(
    drawer,
    el("div.body.stack", [
      el("div.spread", title, buttons),
      note,
      trouble,
      el("div.pictures", [figures.map(({ figure }) => figure)]),
      el("label.row", el("span.small", "Opacity on the map"), fade),
      seen,
      rejected,
    ]),
  );

  const clearOverlays = () => {
    for (const overlay of overlays.values()) overlay.remove();
    overlays.clear();
  };
  const update = () => {
    const { result } = shown;
    const { drawer: isOpen, frame } = getState();
    const wasHidden = drawer.hidden;
    drawer.hidden = !(isOpen && result);
    if (wasHidden !== drawer.hidden) shown.map?.invalidateSize({ pan: false });
    stop.abort();
    clearTimeout(timer);
    if (drawer.hidden || !result) return clearOverlays();
    const row = result.frame.rows.get(frame);
    if (row === undefined) {
      if (result.keyframes.length && result.job.id === getState().job) setState({ frame: firstDetection(result) });
      return;
    }
    fill(title, `Keyframe at scan ${frame}`);
    const detections = result.byFrame.get(frame ?? -1) ?? [];
    const count = `${row + 1} of ${result.keyframes.length}, ${plural(detections.length, "detection")}`;
    const area = `Pictures of ${formatMetres(result.roi_m, 0)} around the vehicle`;
    fill(
      note,
      `${count}. ${area}, in the middle; ${result.local ? "x of the drive’s frame to the right" : "north up"}.`,
    );
    const turn = result.frame.worldAngle(result.keyframes[row]);
    const size = 1 / (Math.abs(Math.cos(turn)) + Math.abs(Math.sin(turn))); // its corners stay within
    document.documentElement.style.setProperty("--turned", `rotate(${-turn}rad) scale(${size})`);
    fill(seen, detectionTable(detections));
    for (const { image } of figures) image.classList.add("waiting");
    fill(trouble, busy("The steps are being drawn…"));
    timer = setTimeout(() => void load(), PAUSE_MS);
  };

  const load = async () => {
    const { result } = shown;
    const { frame } = getState();
    if (!result || frame === null || drawer.hidden) return;
    stop.abort();
    stop = new AbortController();
    const { signal } = stop;
    const keyframe = `jobs/${result.job.id}/keyframes/${frame}`;
    try {
      /** @type {Promise<{corners_lonlat: number[][]|null, corners_world_m: number[][], candidates: any[]}>} */
      const geometry = getJson(`${keyframe}/bev`, { signal });
      geometry.catch(() => {});
      const showPicture = async (/** @type {typeof figures[0]} */ { layer, image }) => {
        const url = await loadPicture(`${keyframe}/bev.png?layer=${layer}`, signal);
        if (signal.aborted) return;
        image.src = url;
        image.classList.remove("waiting");
      };
      await Promise.all(figures.map(showPicture));
      fill(trouble);
      const { corners_lonlat, corners_world_m, candidates } = await geometry;
      if (signal.aborted) return;
      for (const { layer, image, button, nothing } of figures) {
        const isEmpty = OF_CANDIDATES.has(layer) && !candidates.length;
        image.hidden = button.disabled = isEmpty;
        nothing.hidden = !isEmpty;
      }
      fill(rejected, rejectedCandidates(candidates));
      place(result.local ? corners_world_m : corners_lonlat);
    } catch (error) {
      if (signal.aborted) return;
      clearOverlays();
      fill(trouble, problemNote(error));
    }
  };

  /** @param {number[][]|null} corners Top left, top right, bottom right, bottom left. */
  const place = (corners) => {
    const fresh = new Map();
    if (corners) {
      const at = [0, 1, 3].map((i) => /** @type {[number, number]} */ ([corners[i][1], corners[i][0]]));
      for (const { layer, image } of figures) {
        if (onMap.has(layer)) fresh.set(layer, new TurnedImage(image.src, at, { opacity }).addTo(shown.map));
      }
    }
    clearOverlays();
    for (const [layer, overlay] of fresh) overlays.set(layer, overlay);
  };

  subscribe(["frame", "drawer"], update);
  onResult(update);
}

/** @param {string} name @param {string} hint @param {string} src */
function showLarge(name, hint, src) {
  const content = [el("img", { src, alt: name }), el("p.small", hint)];
  openDialog(`${name}, scan ${getState().frame}`, content, { kind: "large-picture" });
}

/** @param {import("../data/results.js").Detection[]} detections */
function detectionTable(detections) {
  if (!detections.length) return el("p.quiet", "Nothing was detected here.");
  const outcomes = { TP: " true", FP: " false", none: "" };
  const rows = detections.map(({ properties: p, outcome, error_m }, i) => [
    [signIcon(outcome === "FP" ? "fp" : "tp"), ` ${i + 1}${outcomes[outcome]}`],
    formatMetres(p.x_m, 1),
    formatMetres(p.y_m, 1),
    p.branch_count,
    p.score?.toFixed(2) ?? "–",
    formatMetres(error_m),
  ]);
  return table(["Detection", "Ahead", "Left", "Branches", "Score", "Error"], rows);
}

/** Why candidates are not intersections. @param {any[]} candidates */
function rejectedCandidates(candidates) {
  const rejected = candidates.filter((each) => !each.kept);
  if (!rejected.length) return null;
  const items = rejected.map((each) => [el("b", each.number), ` ${each.why_not ?? "rejected"}`]);
  return el("div", el("h3", "Candidates that were rejected"), bullets(items));
}
