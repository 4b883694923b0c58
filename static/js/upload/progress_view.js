/** How far an upload is: steps, figures, what the service found, and what can be done about it. */

import { announce, el, fill, formatBytes, formatCount, formatDuration, formatMetres, icon, plural } from "../dom.js";
import { problemList } from "./controls.js";
import { LAYOUTS, POSE_OWNERS, STEPS } from "./words.js";

const REDRAW_MS = 150;

/** @typedef {import("./upload.js").Upload} Upload */

/**
 * @param {object} actions
 * @param {() => void} actions.onChange Change the settings, and go on.
 * @param {() => void} actions.onMend Pick the folder again, and go on.
 * @param {() => void} actions.onLeave Back to the start.
 */
export function progressView({ onChange, onMend, onLeave }) {
  const title = el("h2", { class: "cut" });
  const badge = el("span", {});
  const steps = el("ol", { class: "steps" });
  const bar = el("progress", { max: 1, "aria-label": "Progress of the upload" });
  const figures = el("dl", { class: "figures" });
  const line = el("p", { class: "small quiet", role: "status" });
  const plan = el("div", {});
  const problems = el("div", {});
  const fault = el("div", { role: "alert" });
  const buttons = el("div", { class: "row" });
  const element = el(
    "div",
    { class: "stack upload-progress" },
    el("div", { class: "spread" }, title, badge),
    steps,
    bar,
    line,
    figures,
    fault,
    problems,
    buttons,
    plan,
  );
  /** Which buttons are shown: they are not made anew while someone is about to press one. */
  let shownButtons = "";
  let shownFault = "";
  let shownSteps = "";
  let shownProblems = "";
  let timer = 0;

  /** @param {Upload} upload */
  function draw(upload) {
    const { status, step, transfer, error } = upload;
    title.textContent = upload.settings.name;
    const [kind, text] = BADGES[status];
    badge.className = `badge ${kind}`;
    badge.textContent = text;
    const at = upload.steps.indexOf(step);
    const marks = JSON.stringify([status, step]);
    if (marks !== shownSteps)
      fill(
        steps,
        upload.steps.map((each, i) =>
          stepItem(
            each,
            status === "done" || i < at ? "done" : i > at ? "ahead" : status === "failed" ? "failed" : "now",
          ),
        ),
      );
    shownSteps = marks;
    const isSending = step === "files" || step === "scans" || step === "archive";
    const fraction =
      status === "done" ? 1 : isSending ? transfer.meter.fraction : upload.total ? upload.done / upload.total : null;
    if (fraction === null) bar.removeAttribute("value");
    else bar.value = fraction;
    bar.hidden = status === "failed" || status === "stopped";
    line.hidden = bar.hidden;
    line.textContent =
      transfer.waiting ?? (transfer.isPaused ? "Paused. What is on its way still arrives." : upload.message);
    fill(figures, figuresOf(upload, isSending));
    drawPlan(upload.plan);
    plan.hidden = status === "failed" && step === "plan";
    const faults = JSON.stringify(error);
    if (faults !== shownFault)
      fill(fault, error && el("div", { class: "note error" }, el("strong", {}, error.title), error.detail));
    shownFault = faults;
    const list = JSON.stringify(upload.problems);
    if (list !== shownProblems)
      fill(problems, upload.problems.length > 0 && [el("h3", {}, "What was found"), problemList(upload.problems)]);
    shownProblems = list;
    drawButtons(upload);
  }

  /** @param {Upload} upload */
  function drawButtons(upload) {
    const { status } = upload;
    if (status === shownButtons) return;
    shownButtons = status;
    const stop = el("button", { onClick: () => upload.stop() }, "Stop");
    const isFiles = upload.problems.length > 0;
    const again = el(
      "button",
      { class: isFiles ? "" : "primary", onClick: () => upload.run() },
      status === "stopped" ? "Continue" : "Try again",
    );
    const change = el("button", { onClick: onChange }, "Change settings");
    const mend = el("button", { class: isFiles ? "primary" : "", onClick: onMend }, "Pick the mended folder");
    const leave = el("button", { class: "plain", onClick: onLeave }, "Back");
    const sets = {
      ready: [],
      running: [el("button", { onClick: () => upload.pause() }, icon("pause"), "Pause"), stop],
      paused: [el("button", { class: "primary", onClick: () => upload.resume() }, icon("play"), "Resume"), stop],
      failed: isFiles ? [mend, change, again, leave] : [again, change, mend, leave],
      stopped: [again, change, leave],
      done: [el("button", { class: "primary", onClick: onLeave }, "Upload another")],
    };
    fill(buttons, sets[status]);
    announce(BADGES[status][1]);
  }

  /** @param {any} found */
  function drawPlan(found) {
    if (!found || plan.childElementCount) return;
    const owner = POSE_OWNERS[/** @type {keyof typeof POSE_OWNERS} */ (found.pose_frame)] ?? found.pose_frame;
    const row = (/** @type {string} */ name, /** @type {any} */ value, /** @type {any} */ why = null) =>
      value && [el("dt", {}, name), el("dd", {}, value, why && el("small", { class: "why" }, why))];
    fill(
      plan,
      el(
        "dl",
        { class: "figures box wordy" },
        row("Layout", LAYOUTS[/** @type {keyof typeof LAYOUTS} */ (found.layout)] ?? found.layout),
        row("Poses", owner, found.pose_frame_reason),
        row("Georeference", found.georeference ?? "none", found.georeference_reason),
        row("Way", found.length_m !== null && found.length_m !== undefined && formatMetres(found.length_m)),
        row("To be sent", `${formatCount(found.frames.length)} of ${plural(found.scans, "scan")}`),
      ),
    );
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
  paused: ["", "Paused"],
  failed: ["error", "Stopped by a problem"],
  stopped: ["", "Stopped"],
  done: ["good", "Done"],
};

/** @param {import("./upload.js").Step} step @param {"done" | "now" | "ahead" | "failed"} state */
function stepItem(step, state) {
  const spoken = { done: "done", now: "under way", ahead: "to come", failed: "failed" }[state];
  return el(
    "li",
    { class: state, "aria-current": state === "now" ? "step" : null },
    STEPS[step],
    el("span", { class: "unseen" }, `, ${spoken}`),
  );
}

/** @param {Upload} upload @param {boolean} isSending */
function figuresOf(upload, isSending) {
  const { transfer, done, total, step, source } = upload;
  const { meter } = transfer;
  /** @type {any[]} */
  const rows = [];
  const row = (/** @type {string} */ name, /** @type {string} */ value) =>
    rows.push(el("dt", {}, name), el("dd", {}, value));
  if (total)
    row(
      step === "scans" && source.drive?.scans && upload.settings.sending !== "raw" ? "Scans" : "Files",
      `${formatCount(done)} of ${formatCount(total)}`,
    );
  if (meter.sent || meter.skipped)
    row("Sent", `${formatBytes(meter.sent)} of about ${formatBytes(Math.max(meter.total, meter.sent))}`);
  if (meter.skipped) row("There already", formatBytes(meter.skipped));
  if (isSending && upload.status === "running") {
    if (meter.speed !== null) row("Speed", `${formatBytes(meter.speed)}/s`);
    if (meter.secondsLeft !== null && step !== "files") row("Time left", `about ${formatDuration(meter.secondsLeft)}`);
  }
  return rows;
}
