/** How far an upload is: steps, figures, what the service found, and what can be done about it. */

import { factRows, problemList } from "../controls.js";
import { announce, el, fill, formatBytes, formatCount, formatDuration, icon } from "../dom.js";
import { problemNote } from "../messages.js";

/** @import { Upload } from "./upload.js" */

const REDRAW_MS = 150;
const STEPS = { archive: "Archive", plan: "Plan", files: "Files", check: "Check", run: "Job" };

/**
 * @param {object} actions
 * @param {() => void} actions.onChange Change the settings, and go on.
 * @param {() => void} actions.onCorrect Pick the folder again, and go on.
 * @param {() => void} actions.onLeave Back to the start.
 */
export function progressView({ onChange, onCorrect, onLeave }) {
  const title = el("h2.cut");
  const badge = el("span");
  const steps = el("ol.steps");
  const bar = el("progress", { max: 1, "aria-label": "Progress of the upload" });
  const figures = el("dl.figures");
  const line = el("p.small.quiet", { role: "status" });
  const problems = el("div");
  const fault = el("div", { role: "alert" });
  const buttons = el("div.row");
  const head = el("div.spread", title, badge);
  const parts = [head, steps, bar, line, figures, fault, problems, buttons];
  const element = el("div.stack.upload-progress", parts);
  /** Which buttons are shown: they are not made anew while someone is about to press one. */
  let shownButtons = "";
  let timer = 0;
  /** What was drawn last, by where. @type {Map<HTMLElement, string>} */
  const drawn = new Map();
  /** @param {HTMLElement} part @param {any} what @param {() => any} make Its content, where that is another. */
  const drawOnce = (part, what, make) => {
    if (drawn.get(part) === JSON.stringify(what)) return;
    drawn.set(part, JSON.stringify(what));
    fill(part, make());
  };

  /** @param {Upload} upload */
  function draw(upload) {
    const { status, step, transfer, error } = upload;
    title.textContent = upload.settings.name;
    const [kind, text] = BADGES[status];
    badge.className = `badge ${kind}`;
    badge.textContent = text;
    const at = upload.steps.indexOf(step);
    const stateOf = (/** @type {number} */ i) => {
      if (status === "done" || i < at) return "done";
      if (i > at) return "ahead";
      return status === "failed" ? "failed" : "now";
    };
    drawOnce(steps, [status, step], () => upload.steps.map((each, i) => stepItem(each, stateOf(i))));
    const fraction = status === "done" ? 1 : (upload.sent ?? (upload.total ? upload.done / upload.total : null));
    if (fraction === null) bar.removeAttribute("value");
    else bar.value = fraction;
    bar.hidden = status === "failed" || status === "stopped";
    line.hidden = bar.hidden;
    line.textContent = transfer.waiting ?? upload.message;
    fill(figures, figuresOf(upload));
    drawOnce(fault, error, () => error && problemNote(error));
    const found = upload.problems;
    drawOnce(problems, found, () => found.length > 0 && [el("h3", "What was found"), problemList(found)]);
    drawButtons(upload);
  }

  /** @param {Upload} upload */
  function drawButtons(upload) {
    const { status } = upload;
    if (status === shownButtons) return;
    shownButtons = status;
    const isFiles = upload.problems.length > 0;
    const next = status === "stopped" ? "Continue" : "Try again";
    const again = el("button", { class: isFiles ? "" : "primary", onClick: () => upload.run() }, next);
    const change = el("button", { onClick: onChange }, "Change settings");
    const correct = el("button", { class: isFiles ? "primary" : "", onClick: onCorrect }, "Pick the corrected folder");
    const leave = el("button.plain", { onClick: onLeave }, "Back");
    const sets = {
      ready: [],
      running: [el("button", { onClick: () => upload.stop() }, icon("pause"), "Stop")],
      failed: isFiles ? [correct, change, again, leave] : [again, change, correct, leave],
      stopped: [again, change, leave],
      done: [el("button.primary", { onClick: onLeave }, "Upload another")],
    };
    fill(buttons, sets[status]);
    announce(BADGES[status][1]);
  }

  return {
    element,
    /** @param {Upload} upload */
    update(upload) {
      if (timer && upload.status === shownButtons) return;
      clearTimeout(timer);
      draw(upload);
      timer = window.setTimeout(() => {
        timer = 0;
        draw(upload);
      }, REDRAW_MS);
    },
  };
}

/** @type {Record<import("./upload.js").Status, [string, string]>} */
const BADGES = {
  ready: ["", "Ready"],
  running: ["busy", "Uploading"],
  failed: ["error", "Stopped by a problem"],
  stopped: ["", "Stopped"],
  done: ["good", "Done"],
};

/** @param {import("./upload.js").Step} step @param {"done" | "now" | "ahead" | "failed"} state */
function stepItem(step, state) {
  const readAloud = { done: "done", now: "under way", ahead: "to come", failed: "failed" }[state];
  const props = { class: state, "aria-current": state === "now" ? "step" : null };
  return el("li", props, STEPS[step], el("span.unseen", `, ${readAloud}`));
}

/** @param {Upload} upload */
function figuresOf({ transfer, done, total, step, status, sent, secondsLeft }) {
  const { meter } = transfer;
  const isUnderWay = sent !== null && status === "running";
  const seconds = isUnderWay ? meter.secondsLeft : step === "check" ? secondsLeft : null;
  const all = formatBytes(Math.max(meter.total, meter.sent));
  return factRows([
    total && [step === "check" ? "Scans" : "Files", `${formatCount(done)} of ${formatCount(total)}`],
    (meter.sent || meter.skipped) && ["Sent", `${formatBytes(meter.sent)} of about ${all}`],
    meter.skipped && ["There already", formatBytes(meter.skipped)],
    isUnderWay && meter.speed !== null && ["Speed", `${formatBytes(meter.speed)}/s`],
    seconds !== null && ["Time left", `about ${formatDuration(seconds)}`],
  ]);
}
