/** The job at hand: its progress while it runs, its outcome in figures, its failure explained. */
import { ApiError, getJson, onTokenChange, sendJson, sleep } from "../api.js";
import { factList } from "../controls.js";
import { FINAL, lists, refreshLists, rememberDrive, rememberJob, titleOf } from "../data/lists.js";
import { loadResult } from "../data/results.js";
import { announce, el, fill, formatAgo, formatBytes, formatCount, formatDuration, icon } from "../dom.js";
import { confirmAction, problemNote, retryNote, showError } from "../messages.js";
import { getState, setState, subscribe } from "../state.js";
import { rename } from "./naming.js";
import { openRunDialog } from "./run_dialog.js";
import { ANYONE, standing, stateBadge } from "./words.js";

const STAGES = [
  ["waiting", "Waiting for its turn"],
  ["preparing", "Reading the drive"],
  ["detecting", "Finding intersections"],
  ["mapping", "Joining detections to a map"],
  ["locating", "Placing the drive on the map"],
  ["evaluating", "Scoring against OpenStreetMap"],
];
const POLL_MS = 1000; // between looks at a job that runs
const HIDDEN_MS = 10000; // the same, while nobody looks at the page
const PATIENCE_MS = 15000; // for an answer

/** @param {HTMLElement} container */
export function mountJob(container) {
  let stop = new AbortController();
  const silence = el("p.note.warning", { role: "status", hidden: true }, [
    el("strong", "The server does not answer"),
    "This page tries again until it does. Jobs survive a restart: they go on where they stopped.",
  ]);

  const start = async () => {
    stop.abort();
    stop = new AbortController();
    const { signal } = stop;
    silence.hidden = true;
    const id = getState().job;
    if (!id) return fill(container, el("p.quiet", "Choose a job, or run a drive."));
    try {
      let job = lists.jobs.find((each) => each.id === id) ?? (await loadResult(id)).job;
      while (!signal.aborted) {
        show(rememberJob(job));
        if (FINAL.has(job.state)) return;
        await sleep(document.hidden ? HIDDEN_MS : POLL_MS, signal);
        const patience = AbortSignal.any([signal, AbortSignal.timeout(PATIENCE_MS)]);
        const next = await getJson(`jobs/${id}`, { signal: patience }).catch((error) => {
          if (error instanceof ApiError && !error.isPassing) throw error;
          return null;
        });
        if (signal.aborted) return;
        silence.hidden = next !== null;
        job = next ?? job;
      }
    } catch (error) {
      if (!signal.aborted) fill(container, retryNote(error, start));
    }
  };

  /** The job as it was shown last: its end may come by the list first. @type {any} */
  let last = null;
  /** @param {any} job */
  const show = (job) => {
    const isSame = last?.id === job.id;
    if (isSame && FINAL.has(job.state) && !FINAL.has(last.state)) announce(`The job is ${job.state}.`);
    last = job;
    const title = el("h2.cut", { title: job.drive_name }, job.drive_name);
    const owner = job.owner === ANYONE ? "" : ` by ${job.owner}`;
    const edit = rename(`jobs/${job.id}`, job, "this job", (changed) => show(rememberJob(changed)));
    /** @type {Record<string, (job: any) => any>} */
    const bodies = { successful: outcome, failed: failure, dismissed };
    fill(
      container,
      el("div.stack", [
        el("div", [
          el("div.spread", title, stateBadge(job.state)),
          el("div.spread.named", el("h3.job-title.grow", titleOf(job)), edit),
          job.note && el("p.small.noted", job.note),
          el("p.small", `Submitted ${formatAgo(job.created_at)}${owner}`),
        ]),
        silence,
        (bodies[job.state] ?? progress)(job),
      ]),
    );
  };

  redraw = () => last && show(last);
  subscribe(["job"], () => void start());
  onTokenChange(() => void start());
  void start();
}

/** @param {any} job */
function progress(job) {
  const { done, total, fraction, seconds_left: left } = job.progress;
  const isPlaced = job.request.georeference === "map";
  const stages = STAGES.filter(([id]) => (id !== "evaluating" || job.request.osm) && (id !== "locating" || isPlaced));
  const at = stages.findIndex(([id]) => id === job.stage);
  const now = Math.max(0, at);
  const percent = Math.floor(100 * fraction);
  if (percent % 10 === 0) announce(`${percent} percent`);
  const items = stages.map(([, text], i) => {
    const props = { class: i < now ? "done" : i === now ? "now" : "", "aria-current": i === now ? "step" : null };
    return el("li", props, text);
  });
  const count = total ? `${formatCount(done)} of ${formatCount(total)} keyframes` : "Counting the keyframes";
  const rest = typeof left === "number" && total ? `${formatDuration(Math.max(1, Math.round(left)))} left` : "";
  const cancel = async () => rememberJob(await sendJson("DELETE", `jobs/${job.id}`));
  const retried = `Attempt ${job.attempts}: a worker died; the job goes on where it stopped.`;
  return [
    el("ol.steps", items),
    el("div.stack-s", [
      el("progress", { max: 1, value: total ? fraction : null, "aria-label": "Progress" }),
      el("div.spread.small.number", el("span", count), el("span", rest)),
      job.message && el("p.small", job.message),
      job.attempts > 1 && el("p.note.warning", retried),
    ]),
    el("div.row", el("button.danger", { onClick: () => cancel().catch(showError) }, "Cancel the job")),
    el("p.small", "You may close this page: the server goes on, and the job is in the list of drives."),
  ];
}

/** @param {{scans: number, of: number, stretches_m: [number, number][]}} lost Scans that a live drive dropped. */
const lostText = ({ scans, of, stretches_m: at }) =>
  `${formatCount(scans)} of ${formatCount(of)}${at.length ? `: ${stretchesText(at)}` : ""}`;

/** @param {[number, number][]} stretches Along the track, metres. */
function stretchesText(stretches) {
  return `${stretches.map(([start, stop]) => `${formatCount(start)} to ${formatCount(stop)} m`).join(", ")} of the track`;
}

/** @param {any} job */
function outcome(job) {
  const summary = job.summary ?? {};
  const { report, seconds, keyframes, dropped: lost } = summary;
  /** @type {number[]} */
  const stages = Object.values(summary.stage_seconds ?? {});
  const methodSeconds = stages.reduce((sum, each) => sum + each, 0); // without the start of workers, and the map
  const { osm, policy } = job.request;
  const settings = Object.entries(job.own_settings);
  const own = settings.map(([name, value]) => el("code", `${name} = ${JSON.stringify(value)} `));
  const finished = new Date(job.finished_at).toLocaleString("en-GB", { dateStyle: "medium", timeStyle: "short" });
  const isPlaced = summary.georeferenced !== false;
  const unscored = isPlaced
    ? "The job had no map. Run it again with one to see which intersections are right."
    : "The drive has no georeference: run it again with a map, and it is placed there by its roads.";
  const withMap = () => openRunDialog(job.drive_id, { job, withMap: true }).catch(showError);
  const unfold = (/** @type {any} */ event) => (isUnfolded = event.currentTarget.open);
  const to = (/** @type {string} */ panel) => () => setState({ panel });
  return [
    report?.map_line && el("p.verdict", el("strong", report.map_line)),
    !report && el("p.note", el("strong", "Not scored"), unscored),
    summary.doubtful_labels_m?.length > 0 &&
      el("p.note.warning", el("strong", "Labels doubtful"), stretchesText(summary.doubtful_labels_m)),
    lost && el("p.note.warning", el("strong", "Scans lost"), lostText(lost)),
    el("div.row", [
      !report && el("button.primary", { onClick: withMap }, "Run again with a map…"),
      el("button", { class: report ? "primary" : "", onClick: to("export") }, icon("download"), "Export"),
      report && el("button", { onClick: to("compare") }, "Compare"),
      report && runAgain(job, ""),
    ]),
    el("details.stack-s", { open: isUnfolded, onToggle: unfold }, [
      el("summary", "How it was made"),
      factList("", [
        ["Preset", job.request.preset ?? "default"],
        job.request.labels && ["Labels", job.request.labels],
        ["Map", osm ? (osm.file ?? "OpenStreetMap, by Overpass") : "none"],
        osm && ["Policy", policy ?? "drive"],
        summary.location && ["Placed by its roads", placedText(summary.location)],
        ["Own settings", own.length ? own : "none"],
        ["Keyframes", formatCount(keyframes ?? 0)],
        ["Detections", formatCount(summary.detections ?? 0)],
        seconds !== undefined && ["Time", formatDuration(seconds)],
        methodSeconds && keyframes && ["Per keyframe", `${((1000 * methodSeconds) / keyframes).toFixed(1)} ms`],
        summary.peak_memory_bytes && ["Peak memory", formatBytes(summary.peak_memory_bytes)],
        ["Finished", finished],
        ["Job", el("code", job.id)],
      ]),
      el("div.row", pinButton(job), removal(job)),
    ]),
  ];
}

/** @param {any} job */
function pinButton(job) {
  const isPinned = standing(job) === "pinned";
  const title = "Shown for the drive on the map of all drives and at /ogc; else the best of its jobs is";
  const onClick = () => pin(job, isPinned ? null : job.id).catch(showError);
  return el("button", { title, onClick }, isPinned ? "No longer pin this result" : "Pin this result");
}

/** @param {any} job @param {string|null} pinned_job */
async function pin(job, pinned_job) {
  rememberDrive(await sendJson("PATCH", `drives/${job.drive_id}`, { pinned_job }));
  announce(pinned_job ? "Pinned." : "No longer pinned.");
  rememberJob(job);
  redraw();
}

/** Of the panel. */
let redraw = () => {};
/** Whether it says how the result was made. */
let isUnfolded = false;

/** @param {any} location */
function placedText({ lat_deg, lon_deg, heading_deg, position_std_m }) {
  const place = `${lat_deg.toFixed(5)}, ${lon_deg.toFixed(5)}, heading ${Math.round(heading_deg)}°`;
  return `first scan at ${place}; ±${position_std_m.toFixed(1)} m (1 σ)`;
}

/** @param {any} job */
function failure(job) {
  const back = el("button", { onClick: () => setState({ panel: "drives" }) }, "Back to the drives");
  return [
    problemNote(job.error ?? { title: "The job failed", detail: "The server reported no reason; its log has it." }),
    el("p.quiet", "Correct what is named above, then run it again. The drive is still there."),
    el("div.row", runAgain(job), back, removal(job)),
  ];
}

/** @param {any} job */
function dismissed(job) {
  return [el("p.quiet", "This job was cancelled; it has no result."), el("div.row", runAgain(job), removal(job))];
}

/** @param {any} job */
function removal(job) {
  return el("button.plain.danger", { onClick: () => remove(job).catch(showError) }, icon("trash"), "Delete this job");
}

/** @param {any} job */
async function remove(job) {
  const text = "Its results go with it; the drive stays. This cannot be undone, but the drive can be run again.";
  if (!(await confirmAction("Delete this job?", text, "Delete the job"))) return;
  await sendJson("DELETE", `jobs/${job.id}?purge=true`);
  setState({ job: null, frame: null, view: null, panel: "drives" });
  await refreshLists();
}

/** @param {any} job @param {string} [kind] */
export function runAgain(job, kind = "primary") {
  const open = () => openRunDialog(job.drive_id, { job }).catch(showError);
  return el("button", { class: kind, onClick: open }, "Run again…");
}
