/** How far an upload is: steps, figures, what the service found, and what can be done about it. */

import { factRows, problemList } from "../controls.js";
import { announce, el, fill, formatBytes, formatCount, formatDuration, icon } from "../dom.js";
import { problemNote } from "../messages.js";

/** @import { Upload } from "./upload.js" */

const REDRAW_MS = 150;
const STEPS = { archive: "Archive", plan: "Plan", files: "Files", check: "Check", run: "Job" };
/** @type {Record<import("./upload.js").Status, [string, string]>} */
const BADGES = {
  ready: ["", "Ready"],
  running: ["busy", "Uploading"],
  failed: ["error", "Stopped by a problem"],
  stopped: ["", "Stopped"],
  done: ["good", "Done"],
};

/**
 * @param {object} actions
 * @param {() => void} actions.onChange Change the settings, and go on.
 * @param {() => void} actions.onCorrect Pick the folder again, and go on.
 * @param {() => void} actions.onLeave Back to the start.
 */
export function progressView({ onChange, onCorrect, onLeave }) {
  const head = el("div.spread");
  const steps = el("ol.steps");
  const bar = el("progress", { max: 1, "aria-label": "Progress of the upload" });
  const figures = el("dl.figures");
  const line = el("p.small.quiet", { role: "status" });
  const found = el("div", { role: "alert" });
  const buttons = el("div.row");
  const element = el("div.stack.upload-progress", [head, steps, bar, line, figures, found, buttons]);
  /** Status and step that are shown: what stands still is not made anew while someone is about to press it. */
  let shown = "";
  let timer = 0;

  /** @param {Upload} upload */
  function draw(upload) {
    const { status, step, transfer } = upload;
    const fraction = status === "done" ? 1 : (upload.sent ?? (upload.total ? upload.done / upload.total : null));
    if (fraction === null) bar.removeAttribute("value");
    else bar.value = fraction;
    bar.hidden = line.hidden = status === "failed" || status === "stopped";
    line.textContent = transfer.waiting ?? upload.message;
    fill(figures, figuresOf(upload));
    const now = JSON.stringify([status, step, upload.error, upload.problems]);
    if (now === shown) return;
    shown = now;
    const [kind, text] = BADGES[status];
    fill(head, el("h2.cut", upload.settings.name), el("span", { class: `badge ${kind}` }, text));
    fill(steps, stepItems(upload));
    const list = upload.problems.length > 0 && [el("h3", "What was found"), problemList(upload.problems)];
    fill(found, upload.error && problemNote(upload.error), list);
    fill(buttons, buttonsOf(upload));
    announce(text);
  }

  /** @param {Upload} upload */
  function buttonsOf(upload) {
    const isFiles = upload.problems.length > 0;
    const next = upload.status === "stopped" ? "Continue" : "Try again";
    const again = el("button", { class: isFiles ? "" : "primary", onClick: () => upload.run() }, next);
    const change = el("button", { onClick: onChange }, "Change settings");
    const correct = el("button", { class: isFiles ? "primary" : "", onClick: onCorrect }, "Pick the corrected folder");
    const leave = el("button.plain", { onClick: onLeave }, "Back");
    return {
      ready: [],
      running: [el("button", { onClick: () => upload.stop() }, icon("pause"), "Stop")],
      failed: isFiles ? [correct, change, again, leave] : [again, change, correct, leave],
      stopped: [again, change, leave],
      done: [el("button.primary", { onClick: onLeave }, "Upload another")],
    }[upload.status];
  }

  return {
    element,
    /** @param {Upload} upload */
    update(upload) {
      if (timer && shown.startsWith(`["${upload.status}"`)) return;
      clearTimeout(timer);
      draw(upload);
      timer = window.setTimeout(() => {
        timer = 0;
        draw(upload);
      }, REDRAW_MS);
    },
  };
}

/** @param {Upload} upload */
function stepItems({ steps, step, status }) {
  const at = steps.indexOf(step);
  const words = { done: "done", now: "under way", ahead: "to come", failed: "failed" };
  return steps.map((each, i) => {
    const current = status === "failed" ? "failed" : "now";
    const state = status === "done" || i < at ? "done" : i > at ? "ahead" : current;
    const props = { class: state, "aria-current": state === "now" ? "step" : null };
    return el("li", props, STEPS[each], el("span.unseen", `, ${words[state]}`));
  });
}

/** @param {Upload} upload */
function figuresOf({ transfer, done, total, step, status, sent, secondsLeft }) {
  const { meter } = transfer;
  const isUnderWay = sent !== null && status === "running" && !transfer.waiting;
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
