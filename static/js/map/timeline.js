/** The strip below the map: all keyframes of the drive, what each one saw, and play. */
import { iconButton, select } from "../controls.js";
import { el, fill, formatDuration, icon, plural } from "../dom.js";
import { addShortcut } from "../shortcuts.js";
import { getState, setState, subscribe } from "../state.js";
import { chosenFrame } from "./details.js";
import { colour } from "./paths.js";
import { firstDetection } from "./shown.js";

/** @import { Result } from "../data/results.js" */

const SPEEDS = [5, 10, 25, 60];

/** @param {HTMLElement} strip @returns {{show: (result: Result|null) => void, isFollowing: () => boolean}} */
export function mountTimeline(strip) {
  /** @type {Result|null} */
  let result = null;
  let playing = 0;
  let last = 0;

  const chart = el("canvas.density", { "aria-hidden": "true" });
  const slider = el("input", { type: "range", min: 0, max: 0, step: 1, "aria-label": "Keyframe" });
  slider.addEventListener("input", () => choose(Number(slider.value)));
  const play = el("button.square", { onClick: () => toggle() });
  const speed = select(Object.fromEntries(SPEEDS.map((each) => [each, `${each}/s`])), "10", undefined, "Speed");
  speed.title = "Keyframes per second";
  const follow = iconButton(
    "follow",
    "Keep the vehicle in view",
    () => setFollowing(!isFollowing()),
    "Keep the vehicle in view; waits while details are open",
  );
  const isFollowing = () => follow.getAttribute("aria-pressed") === "true";
  const setFollowing = (/** @type {boolean} */ on) => follow.setAttribute("aria-pressed", String(on));
  setFollowing(true);
  const label = el("div.timeline-label");
  const lookInside = () => {
    const { drawer, frame } = getState();
    setState({ drawer: !drawer, frame: (drawer ? null : chosenFrame()) ?? frame ?? firstDetection(result) });
  };
  const large = el("button", { "aria-expanded": "false", onClick: lookInside }, icon("image"), "Look inside");
  fill(
    strip,
    el("div.timeline.spread", [
      iconButton("previous", "Previous keyframe", () => step(-1), "Previous keyframe (,)"),
      play,
      iconButton("next", "Next keyframe", () => step(1), "Next keyframe (.)"),
      speed,
      follow,
      el("div.ruler", chart, slider),
      label,
      large,
    ]),
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

  const toggle = () => (playing ? stop() : start());

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
    const clock = typeof time === "number" ? ` · ${formatDuration(time)}` : "";
    const [first, second] =
      frame === null
        ? [plural(result.keyframes.length, "keyframe"), "drag or play"]
        : [`Scan ${frame}${clock}`, `${row + 1} of ${result.keyframes.length} · ${plural(seen, "detection")}`];
    fill(label, el("strong", first), el("span.small", second));
    fill(play, icon(playing ? "pause" : "play"));
    play.setAttribute("aria-label", playing ? "Pause" : "Play");
    play.title = playing ? "Pause (space)" : "Play (space)";
    large.setAttribute("aria-expanded", String(drawer));
    large.setAttribute("aria-pressed", String(drawer));
  };
  subscribe(["frame", "drawer"], update);

  const draw = () => result && drawDensity(chart, result);
  new ResizeObserver(draw).observe(chart);
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", draw);
  addShortcut(" ", "Play the drive, or pause", toggle, "Space");
  addShortcut(",", "Previous keyframe", () => step(-1));
  addShortcut(".", "Next keyframe", () => step(1));

  return {
    show(next) {
      if (playing) stop();
      result = next;
      update();
      draw();
    },
    isFollowing,
  };
}

/** Bars of detections per keyframe, the true ones below, the false ones on top. */
function drawDensity(/** @type {HTMLCanvasElement} */ canvas, /** @type {Result} */ result) {
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
  let max = 1;
  for (let i = 0; i < bins; i += 1) max = Math.max(max, (trues[i] + falses[i]) / sizes[i]);
  const unit = (h - 2) / max;
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
