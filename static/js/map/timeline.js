/**
 * The strip below the map: all keyframes of the drive, what each one saw, and play.
 * @module map/timeline
 */
import { el, fill, formatDuration, icon, plural } from "../dom.js";
import { getState, setState, subscribe } from "../state.js";
import { colour } from "./symbols.js";

const SPEEDS = [5, 10, 25, 60];

/** @param {HTMLElement} strip @returns {{show: (result: import("../data/results.js").Result|null) => void, readonly isFollowing: boolean}} */
export function mountTimeline(strip) {
  /** @type {import("../data/results.js").Result|null} */
  let result = null;
  let playing = 0;
  let last = 0;

  const chart = el("canvas", { class: "density", "aria-hidden": "true" });
  const slider = el("input", {
    type: "range",
    min: 0,
    max: 0,
    step: 1,
    "aria-label": "Keyframe",
    onInput: () => choose(Number(slider.value)),
  });
  const play = el("button", { class: "square", onClick: () => (playing ? stop() : start()) });
  const speed = el(
    "select",
    { "aria-label": "Speed", title: "Keyframes a second" },
    SPEEDS.map((each) => el("option", { value: each, selected: each === 10 }, `${each}/s`)),
  );
  const follow = el(
    "button",
    {
      class: "square plain",
      title: "Keep the vehicle in view",
      "aria-label": "Keep the vehicle in view",
      "aria-pressed": "true",
      onClick: () => follow.setAttribute("aria-pressed", String(follow.getAttribute("aria-pressed") !== "true")),
    },
    icon("follow"),
  );
  const label = el("div", { class: "timeline-label" });
  const large = el(
    "button",
    {
      "aria-expanded": "false",
      onClick: () => setState({ drawer: !getState().drawer, frame: getState().frame ?? firstSight(result) }),
    },
    icon("image"),
    "Look inside",
  );
  fill(
    strip,
    el(
      "div",
      { class: "timeline" },
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
      play,
      el(
        "button",
        { class: "square plain", title: "Next keyframe (.)", "aria-label": "Next keyframe", onClick: () => step(1) },
        icon("next"),
      ),
      speed,
      follow,
      el("div", { class: "ruler" }, chart, slider),
      label,
      large,
    ),
  );

  const rowNow = () => result?.frame.rows.get(getState().frame) ?? 0;
  /** @param {number} row */
  const frameAt = (row) => result?.keyframes[row]?.properties.frame ?? null;
  /** @param {number} row */
  const choose = (row) =>
    result && setState({ frame: frameAt(Math.max(0, Math.min(result.keyframes.length - 1, row))) });
  /** @param {number} by */
  const step = (by) => (stop(), choose(getState().frame === null ? 0 : rowNow() + by));

  const start = () => {
    if (!result) return;
    if (rowNow() >= result.keyframes.length - 1) choose(0);
    last = performance.now();
    const tick = (/** @type {number} */ now) => {
      const ahead = Math.floor(((now - last) / 1000) * Number(speed.value));
      if (ahead > 0) {
        last += (ahead * 1000) / Number(speed.value);
        if (!result || rowNow() + ahead >= result.keyframes.length) {
          if (result) choose(result.keyframes.length - 1);
          return stop();
        }
        choose(rowNow() + ahead);
      }
      playing = requestAnimationFrame(tick);
    };
    playing = requestAnimationFrame(tick);
    update();
  };
  const stop = () => {
    cancelAnimationFrame(playing);
    playing = 0;
    update();
  };

  const update = () => {
    strip.hidden = !result;
    if (!result) return;
    const { frame, drawer } = getState();
    const row = rowNow();
    const keyframe = result.keyframes[row];
    slider.max = String(result.keyframes.length - 1);
    slider.value = String(row);
    strip.classList.toggle("unset", frame === null);
    const seen = result.byFrame.get(keyframe?.properties.frame)?.length ?? 0;
    const time = keyframe?.properties.time_s;
    slider.setAttribute("aria-valuetext", `scan ${keyframe?.properties.frame}, ${plural(seen, "detection")}`);
    fill(
      label,
      frame === null
        ? [el("strong", {}, plural(result.keyframes.length, "keyframe")), el("span", {}, "drag or play")]
        : [
            el("strong", {}, `Scan ${frame}`, time !== null && time !== undefined ? ` · ${formatDuration(time)}` : ""),
            el("span", {}, `${row + 1} of ${result.keyframes.length} · ${plural(seen, "detection")}`),
          ],
    );
    fill(play, icon(playing ? "pause" : "play"));
    play.setAttribute("aria-label", playing ? "Pause" : "Play");
    play.title = playing ? "Pause" : "Play";
    large.setAttribute("aria-expanded", String(drawer));
    large.setAttribute("aria-pressed", String(drawer));
  };
  subscribe(["frame", "drawer"], update);

  const draw = () => result && drawDensity(chart, result);
  new ResizeObserver(draw).observe(chart);
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", draw);
  document.addEventListener("keydown", (event) => {
    const target = /** @type {HTMLElement} */ (event.target);
    if (
      event.ctrlKey ||
      event.metaKey ||
      event.altKey ||
      target.closest("input:not([type=range]):not([type=checkbox]), select, textarea, dialog")
    )
      return;
    if (event.key === ",") step(-1);
    else if (event.key === ".") step(1);
  });

  return {
    show(next) {
      if (playing) stop();
      result = next;
      update();
      draw();
    },
    get isFollowing() {
      return follow.getAttribute("aria-pressed") === "true";
    },
  };
}

/** @param {import("../data/results.js").Result|null} result @returns {number|null} The keyframe of the first detection: there is something to see. */
export function firstSight(result) {
  return result?.detections[0]?.properties.frame ?? result?.keyframes[0]?.properties.frame ?? null;
}

/** Bars of detections a keyframe, the true ones below, the false ones on top. */
function drawDensity(
  /** @type {HTMLCanvasElement} */ canvas,
  /** @type {import("../data/results.js").Result} */ result,
) {
  const ratio = Math.max(1, devicePixelRatio);
  const [w, h] = [canvas.clientWidth, canvas.clientHeight];
  if (!w) return;
  canvas.width = w * ratio;
  canvas.height = h * ratio;
  const context = /** @type {CanvasRenderingContext2D} */ (canvas.getContext("2d"));
  context.scale(ratio, ratio);
  const count = result.keyframes.length;
  const bins = Math.max(1, Math.min(count, Math.floor(w / 2)));
  const trues = new Float64Array(bins);
  const falses = new Float64Array(bins);
  const sizes = new Float64Array(bins);
  result.keyframes.forEach(({ properties }, row) => {
    const bin = Math.min(bins - 1, Math.floor((row * bins) / count));
    sizes[bin] += 1;
    for (const each of result.byFrame.get(properties.frame) ?? []) (each.outcome === "FP" ? falses : trues)[bin] += 1;
  });
  let most = 1;
  for (let i = 0; i < bins; i += 1) most = Math.max(most, (trues[i] + falses[i]) / sizes[i]);
  const unit = (h - 2) / most;
  const width = w / bins;
  for (let i = 0; i < bins; i += 1) {
    const low = (trues[i] / sizes[i]) * unit;
    const high = (falses[i] / sizes[i]) * unit;
    context.fillStyle = colour("--tp");
    context.fillRect(i * width, h - low, Math.max(1, width - 0.5), low);
    context.fillStyle = colour("--fp");
    context.fillRect(i * width, h - low - high, Math.max(1, width - 0.5), high);
  }
}
