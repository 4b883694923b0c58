/**
 * The drawer: what the method saw and did at the chosen keyframe, step by step, and the same pictures on the map.
 * @module bev/drawer
 */
import { el, fill, formatMetres, icon, plural } from "../dom.js";
import { TurnedImage } from "../map/overlay.js";
import { onResult, shown } from "../map/shown.js";
import { signIcon } from "../map/symbols.js";
import { firstSight } from "../map/timeline.js";
import { problemNote } from "../shell/messages.js";
import { getState, setState, subscribe } from "../state.js";
import { loadGeometry, loadPicture, STEPS } from "./pictures.js";

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

  const title = el("h2", {});
  const note = el("p", { class: "small" });
  const trouble = el("div", {});
  const seen = el("div", {});
  const rejected = el("div", {});
  const step = (/** @type {number} */ by) => {
    const result = shown.result;
    const row = result?.frame.rows.get(getState().frame);
    const next = row === undefined ? null : result?.keyframes[row + by];
    if (next) setState({ frame: next.properties.frame });
  };
  const figures = STEPS.map(({ layer, title: name, hint }, number) => {
    const image = el("img", { alt: "", class: "waiting" });
    const box = el("input", {
      type: "checkbox",
      checked: onMap.has(layer),
      onChange: () => toggle(layer, box.checked),
    });
    const figure = el(
      "figure",
      {},
      el(
        "button",
        {
          class: "picture",
          title: `${hint} Click to enlarge.`,
          "aria-label": `Enlarge ${name}`,
          onClick: () => enlarge(layer),
        },
        image,
      ),
      el(
        "figcaption",
        {},
        el("span", {}, el("b", {}, layer === "all" ? "" : `${number + 1} `), name),
        layer !== "all" && el("label", { title: "Show it on the map" }, box, "on map"),
      ),
    );
    return { layer, name, image, figure };
  });
  const fade = el("input", {
    type: "range",
    min: 0.1,
    max: 1,
    step: 0.05,
    value: opacity,
    "aria-label": "Opacity on the map",
    onInput: () => {
      opacity = Number(fade.value);
      for (const overlay of overlays.values()) overlay.setOpacity(opacity);
    },
  });
  fill(
    drawer,
    el(
      "div",
      { class: "drawer-body stack" },
      el(
        "div",
        { class: "spread" },
        title,
        el(
          "div",
          { class: "row" },
          el(
            "button",
            {
              class: "square plain",
              title: "Previous keyframe (,)",
              "aria-label": "Previous keyframe",
              onClick: () => step(-1),
            },
            icon("previous"),
          ),
          el(
            "button",
            {
              class: "square plain",
              title: "Next keyframe (.)",
              "aria-label": "Next keyframe",
              onClick: () => step(1),
            },
            icon("next"),
          ),
          el(
            "button",
            {
              class: "square plain",
              title: "Wider",
              "aria-label": "Wider",
              onClick: () => (drawer.classList.toggle("wide"), shown.map?.invalidateSize()),
            },
            icon("wide"),
          ),
          el(
            "button",
            {
              class: "square plain",
              title: "Close",
              "aria-label": "Close",
              onClick: () => setState({ drawer: false }),
            },
            icon("close"),
          ),
        ),
      ),
      note,
      trouble,
      el(
        "div",
        { class: "pictures" },
        figures.map((each) => each.figure),
      ),
      el("label", { class: "row" }, el("span", { class: "small" }, "Opacity on the map"), fade),
      seen,
      rejected,
    ),
  );

  const clearOverlays = () => {
    for (const overlay of overlays.values()) overlay.remove();
    overlays.clear();
  };
  /** @param {string} layer @param {boolean} isOn */
  const toggle = (layer, isOn) => {
    if (isOn) onMap.add(layer);
    else onMap.delete(layer);
    void load();
  };

  const update = () => {
    const result = shown.result;
    const { drawer: open, frame } = getState();
    const wasHidden = drawer.hidden;
    drawer.hidden = !(open && result);
    if (wasHidden !== drawer.hidden) shown.map?.invalidateSize({ pan: false });
    stop.abort();
    clearTimeout(timer);
    if (drawer.hidden || !result) return clearOverlays();
    const row = result.frame.rows.get(frame);
    if (row === undefined) {
      if (result.keyframes.length) setState({ frame: firstSight(result) });
      return;
    }
    fill(title, `Keyframe at scan ${frame}`);
    const detections = result.byFrame.get(frame ?? -1) ?? [];
    fill(
      note,
      `${row + 1} of ${result.keyframes.length}, ${plural(detections.length, "detection")}. Pictures of ${formatMetres(result.roi_m, 0)} around the vehicle, in the middle; x of the drive’s frame to the right.`,
    );
    fill(seen, detectionTable(detections));
    for (const each of figures) each.image.classList.add("waiting");
    timer = setTimeout(() => void load(), PAUSE_MS);
  };

  const load = async () => {
    const result = shown.result;
    const { frame } = getState();
    if (!result || frame === null || drawer.hidden) return;
    stop.abort();
    stop = new AbortController();
    const { signal } = stop;
    const job = result.job.id;
    try {
      const geometry = loadGeometry(job, frame, signal);
      geometry.catch(() => {});
      await Promise.all(
        figures.map(async ({ layer, image }) => {
          const url = await loadPicture(job, frame, layer, signal);
          if (signal.aborted) return;
          image.src = url;
          image.classList.remove("waiting");
        }),
      );
      fill(trouble);
      fill(rejected, candidateTable((await geometry).candidates));
      place(result, await geometry, new Map(figures.map(({ layer, image }) => [layer, image.src])));
    } catch (error) {
      if (signal.aborted) return;
      clearOverlays();
      fill(trouble, problemNote(error));
    }
  };

  /** @param {import("../data/results.js").Result} result @param {Awaited<ReturnType<typeof loadGeometry>>} geometry @param {Map<string, string>} urls */
  const place = (result, geometry, urls) => {
    const corners = result.local ? geometry.corners_world_m : geometry.corners_lonlat;
    const fresh = new Map();
    if (corners) {
      const at = [0, 1, 3].map((i) => /** @type {[number, number]} */ ([corners[i][1], corners[i][0]]));
      for (const { layer } of STEPS) {
        if (!onMap.has(layer)) continue;
        fresh.set(layer, new TurnedImage(urls.get(layer) ?? "", at, { opacity }).addTo(shown.map));
      }
    }
    clearOverlays();
    for (const [layer, overlay] of fresh) overlays.set(layer, overlay);
  };

  /** @param {string} layer */
  const enlarge = (layer) => {
    const at = figures.findIndex((each) => each.layer === layer);
    const { image, name } = figures[at];
    const large = el("img", { src: image.src, alt: name });
    const dialog = el(
      "dialog",
      {
        class: "large-picture",
        "aria-label": name,
        onClose: () => dialog.remove(),
        onClick: (/** @type {Event} */ e) => e.target === dialog && dialog.close(),
      },
      el(
        "form",
        { method: "dialog", class: "stack-s" },
        el(
          "div",
          { class: "spread" },
          el("h2", {}, `${name}, scan ${getState().frame}`),
          el("button", { class: "square plain", "aria-label": "Close" }, icon("close")),
        ),
        large,
        el("p", { class: "small" }, STEPS[at].hint),
      ),
    );
    document.body.append(dialog);
    dialog.showModal();
  };

  subscribe(["frame", "drawer"], update);
  onResult(update);
}

/** @param {import("../data/results.js").Detection[]} detections */
function detectionTable(detections) {
  if (!detections.length) return el("p", { class: "quiet" }, "Nothing was detected here.");
  return el(
    "table",
    {},
    el(
      "thead",
      {},
      el(
        "tr",
        {},
        ["Detection", "Ahead", "Left", "Branches", "Score", "Error"].map((name) => el("th", { scope: "col" }, name)),
      ),
    ),
    el(
      "tbody",
      {},
      detections.map(({ properties: p, outcome, error_m }, i) =>
        el(
          "tr",
          {},
          el(
            "td",
            {},
            signIcon(outcome === "FP" ? "fp" : "tp"),
            ` ${i + 1}${outcome === "none" ? "" : outcome === "TP" ? " true" : " false"}`,
          ),
          el("td", {}, formatMetres(p.x_m, 1)),
          el("td", {}, formatMetres(p.y_m, 1)),
          el("td", {}, p.branch_count),
          el("td", {}, p.score?.toFixed(2) ?? "–"),
          el("td", {}, formatMetres(error_m)),
        ),
      ),
    ),
  );
}

/**
 * What became of the candidates that are no intersections.
 * @param {any[]} candidates
 */
function candidateTable(candidates) {
  const out = candidates.filter((each) => !each.kept);
  if (!out.length) return null;
  return el(
    "div",
    {},
    el("h3", {}, "Candidates that were rejected"),
    el(
      "ul",
      { class: "reasons" },
      out.map((each) => el("li", {}, el("b", {}, each.number), ` ${each.why_not ?? "rejected"}`)),
    ),
  );
}
