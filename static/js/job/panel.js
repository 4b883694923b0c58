/**
 * The job at hand: its progress while it runs, its outcome in figures, its failure explained.
 * @module job/panel
 */
import { follow, getJson, sendJson } from "../api.js";
import { lists, refreshLists, rememberJob } from "../data/lists.js";
import { ownSettings } from "../data/presets.js";
import {
  announce,
  el,
  fill,
  formatAgo,
  formatBytes,
  formatCount,
  formatDuration,
  formatMetres,
  formatPercent,
  icon,
} from "../dom.js";
import { stateBadge } from "../drives/panel.js";
import { confirmAction, problemNote, showError } from "../shell/messages.js";
import { getState, setState, subscribe } from "../state.js";
import { openRunDialog } from "./run_dialog.js";

const STAGES = [
  ["waiting", "Waiting for its turn"],
  ["preparing", "Reading the drive"],
  ["detecting", "Finding intersections"],
  ["mapping", "Joining detections to a map"],
  ["evaluating", "Scoring against OpenStreetMap"],
];
const LOOK_MS = 15000; // a proxy may hold events back: look now and then, too
const FINAL = new Set(["successful", "failed", "dismissed"]);

/** @param {HTMLElement} container */
export function mount(container) {
  let stop = new AbortController();
  const silence = el(
    "p",
    { class: "note warning", role: "status", hidden: true },
    el("strong", {}, "The server does not answer"),
    "This page tries again until it does. Jobs outlive a restart: they go on where they stopped.",
  );

  const start = async () => {
    stop.abort();
    stop = new AbortController();
    const { signal } = stop;
    silence.hidden = true;
    const id = getState().job;
    if (!id) return fill(container, el("p", { class: "quiet" }, "Choose a job, or run a drive."));
    try {
      const known = lists.jobs.find((each) => each.id === id);
      if (known) show(known);
      const job = await getJson(`jobs/${id}`, { signal });
      if (signal.aborted) return;
      update(job);
      if (FINAL.has(job.state)) return;
      const look = setInterval(
        () =>
          void getJson(`jobs/${id}`, { signal }).then(
            (now) => !signal.aborted && update(now),
            () => {},
          ),
        LOOK_MS,
      );
      signal.addEventListener("abort", () => clearInterval(look));
      await follow(`jobs/${id}/events`, {
        signal,
        onConnection: (connected) => (silence.hidden = connected),
        onEvent: (next) => {
          if (signal.aborted) return true;
          silence.hidden = true;
          update(next);
          if (FINAL.has(next.state)) clearInterval(look);
          return FINAL.has(next.state);
        },
      });
    } catch (error) {
      if (!signal.aborted) fill(container, problemNote(error));
    }
  };

  /** @param {any} job */
  const update = (job) => {
    const before = lists.jobs.find((each) => each.id === job.id);
    if (before && before.version > job.version) return;
    const finished = FINAL.has(job.state) && before && !FINAL.has(before.state);
    rememberJob(job);
    show(job);
    if (finished) {
      announce(`The job is ${job.state}.`);
      document.dispatchEvent(new CustomEvent("job-finished"));
    }
  };

  /** @param {any} job */
  const show = (job) => {
    const focused = container.contains(document.activeElement) ? document.activeElement?.textContent : null;
    fill(
      container,
      el(
        "div",
        { class: "stack" },
        el(
          "div",
          {},
          el(
            "div",
            { class: "spread" },
            el("h2", { class: "cut", title: job.drive_name }, job.drive_name),
            stateBadge(job.state),
          ),
          el(
            "p",
            { class: "small" },
            `Preset ${job.request.preset ?? "default"}, submitted ${formatAgo(job.created_at)}`,
          ),
        ),
        silence,
        job.state === "successful"
          ? outcome(job)
          : job.state === "failed"
            ? failure(job)
            : job.state === "dismissed"
              ? dismissed(job)
              : progress(job),
      ),
    );
    if (focused) [...container.querySelectorAll("button")].find((each) => each.textContent === focused)?.focus();
  };

  subscribe(["job"], () => void start());
  void start();
}

/** @param {any} job */
function progress(job) {
  const { done, total, fraction, seconds_left: left } = job.progress;
  const stages = STAGES.filter(([id]) => id !== "evaluating" || job.request.osm);
  const now = Math.max(
    0,
    stages.findIndex(([id]) => id === job.stage),
  );
  const percent = Math.floor(100 * fraction);
  if (percent % 10 === 0) announce(`${percent} percent`);
  return [
    el(
      "ol",
      { class: "stages" },
      stages.map(([, text], i) =>
        el("li", { class: i < now ? "done" : i === now ? "now" : "", "aria-current": i === now ? "step" : null }, text),
      ),
    ),
    el(
      "div",
      { class: "stack-s" },
      el("progress", { max: 1, value: total ? fraction : null, "aria-label": "Progress" }),
      el(
        "div",
        { class: "spread small number" },
        el("span", {}, total ? `${formatCount(done)} of ${formatCount(total)} keyframes` : "Counting the keyframes"),
        el(
          "span",
          {},
          left !== null && left !== undefined && total ? `${formatDuration(Math.max(1, Math.round(left)))} left` : "",
        ),
      ),
      job.message && el("p", { class: "small" }, job.message),
      job.attempts > 1 &&
        el("p", { class: "note warning" }, `Attempt ${job.attempts}: a worker died; it goes on where it stopped.`),
    ),
    el(
      "div",
      { class: "row" },
      el("button", { class: "danger", onClick: () => cancel(job).catch(showError) }, "Cancel the job"),
    ),
    el("p", { class: "small" }, "You may close this page: the server goes on, and the job is in the list of drives."),
  ];
}

/** @param {any} job */
async function cancel(job) {
  rememberJob(await sendJson("DELETE", `jobs/${job.id}`));
}

/** @param {any} job */
function outcome(job) {
  const summary = job.summary ?? {};
  const report = summary.report ?? null;
  const own = ownSettings(job.request);
  const figures = [
    figure(formatCount(summary.intersections ?? 0), "intersections"),
    figure(formatCount(summary.detections ?? 0), "detections"),
    figure(formatCount(summary.keyframes ?? 0), "keyframes"),
  ];
  if (report) {
    figures.push(figure(formatMetres(report.ace_m), "mean error (ACE)"));
    figures.push(figure(formatPercent(report.precision_at_5), "precision, 5 m"));
    figures.push(figure(formatPercent(report.recall_at_5), "recall, 5 m"));
  }
  return [
    el("div", { class: "tiles-row" }, figures),
    !job.request.osm &&
      el(
        "p",
        { class: "note" },
        el("strong", {}, "Not scored"),
        "The job had no map. Run it again with a map to see which intersections are right.",
      ),
    el(
      "div",
      { class: "row" },
      job.request.osm &&
        el("button", { class: "primary", onClick: () => setState({ panel: "report" }) }, "Open the report"),
      el("button", { onClick: () => setState({ panel: "export" }) }, icon("download"), "Download"),
    ),
    el(
      "dl",
      { class: "figures section" },
      fact("Map", mapOf(job.request)),
      job.request.osm && fact("Policy", job.request.policy ?? "drive"),
      fact(
        "Own settings",
        own.length ? own.map(([name, value]) => el("code", {}, `${name} = ${JSON.stringify(value)} `)) : "none",
      ),
      summary.seconds !== undefined && fact("Time", formatDuration(summary.seconds)),
      summary.seconds && summary.keyframes
        ? fact("A keyframe", `${((1000 * summary.seconds) / summary.keyframes).toFixed(1)} ms`)
        : null,
      summary.peak_memory_bytes && fact("Peak memory", formatBytes(summary.peak_memory_bytes)),
      fact("Finished", new Date(job.finished_at).toLocaleString("en-GB", { dateStyle: "medium", timeStyle: "short" })),
      fact("Job", el("code", {}, job.id)),
    ),
    el(
      "div",
      { class: "row section" },
      el("button", { onClick: () => rerun(job).catch(showError) }, "Run again…"),
      removal(job),
    ),
  ];
}

/** @param {any} request @returns {string} */
export function mapOf(request) {
  if (!request.osm) return "none";
  return request.osm.file ?? "OpenStreetMap, by Overpass";
}

/** @param {any} job */
function failure(job) {
  return [
    problemNote(job.error ?? { title: "The job failed", detail: "The server told no reason; its log does." }),
    el("p", { class: "quiet" }, "Mend what it names, then run it again. The drive is still there."),
    el(
      "div",
      { class: "row" },
      el("button", { class: "primary", onClick: () => rerun(job).catch(showError) }, "Run again…"),
      el("button", { onClick: () => setState({ panel: "drives" }) }, "Back to the drives"),
      removal(job),
    ),
  ];
}

/** @param {any} job */
function dismissed(job) {
  return [
    el("p", { class: "quiet" }, "This job was cancelled; it has no result."),
    el(
      "div",
      { class: "row" },
      el("button", { class: "primary", onClick: () => rerun(job).catch(showError) }, "Run again…"),
      removal(job),
    ),
  ];
}

/** @param {any} job */
function removal(job) {
  return el(
    "button",
    { class: "plain danger", onClick: () => remove(job).catch(showError) },
    icon("trash"),
    "Delete this job",
  );
}

/** @param {any} job */
async function remove(job) {
  if (
    !(await confirmAction(
      "Delete this job?",
      "Its results are removed from the server; the drive stays.",
      "Delete the job",
    ))
  )
    return;
  await sendJson("DELETE", `jobs/${job.id}?purge=true`);
  setState({ job: null, frame: null, view: null, panel: "drives" });
  await refreshLists();
}

/** @param {any} job */
async function rerun(job) {
  await openRunDialog(await getJson(`drives/${job.drive_id}`));
}

/** @param {string} value @param {string} name */
function figure(value, name) {
  return el("div", { class: "figure" }, el("b", {}, value), el("span", {}, name));
}

/** @param {string} name @param {any} value */
function fact(name, value) {
  return [el("dt", {}, name), el("dd", {}, value)];
}
