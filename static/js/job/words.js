/** How drives and jobs are called and opened, wherever they are listed. */
import { getConfig } from "../api.js";
import { demo } from "../data/demo.js";
import { lists, titleOf } from "../data/lists.js";
import { onUploadsChange, ownUpload, uploadText } from "../data/uploads.js";
import { el, formatAgo, formatDuration, formatMetres, plural } from "../dom.js";
import { setState } from "../state.js";

export const ANYONE = "anonymous"; // the owner of all where nobody has a token

const STATES = /** @type {Record<string, [string, string]>} */ ({
  uploading: ["Upload unfinished", ""],
  checking: ["Being checked", "busy"],
  ready: ["Ready", "good"],
  accepted: ["Waiting", "busy"],
  running: ["Running", "busy"],
  successful: ["Done", "good"],
  failed: ["Failed", "error"],
  dismissed: ["Cancelled", ""],
});

/** @param {string} state @returns {HTMLElement} */
export function stateBadge(state) {
  const [text, kind] = STATES[state] ?? [state, ""];
  return el("span", { class: `badge ${kind}` }, text);
}

/** @param {any} drive @returns {HTMLElement} Its state, or how far its upload is. */
export function driveBadge({ id, state }) {
  if (state === "uploading" && demo.isRunning && demo.drive === id) return el("span.badge.busy", "Being made");
  const upload = ownUpload();
  return upload && state === "uploading" && upload.driveId === id
    ? el("span.badge.busy", { dataset: { upload: id } }, uploadText(upload))
    : stateBadge(state);
}

onUploadsChange(() => {
  for (const badge of document.querySelectorAll("[data-upload]")) {
    const upload = ownUpload();
    if (upload && upload.driveId === /** @type {HTMLElement} */ (badge).dataset.upload)
      badge.textContent = uploadText(upload);
  }
});

/** @param {any} job @returns {string} Its title, and when it ended or which state it is in. */
export function jobName(job) {
  return `${titleOf(job)} · ${job.state === "successful" ? formatAgo(job.finished_at ?? job.created_at) : job.state}`;
}

/** @param {any} job @returns {string} The result in a few words: the verdict of the map, where there was one. */
export function outcomeOf(job) {
  const { intersections, report } = job.summary ?? {};
  if (report?.map_line) return report.map_line.replace(/ within [\d.]+ m/, "");
  const parts = [];
  if (intersections !== undefined) parts.push(plural(intersections, "intersection"));
  if (report?.ace_m !== undefined && report.ace_m !== null) parts.push(`ACE ${formatMetres(report.ace_m)}`);
  return parts.join(", ");
}

/** @param {any} job @returns {"pinned"|"best"|null} Why it stands for its drive; null: it does not. */
export function standing({ id, drive_id }) {
  const drive = lists.drives.find((each) => each.id === drive_id);
  return drive?.result_job !== id ? null : drive?.pinned_job === id ? "pinned" : "best";
}

/** Show a drive, with the job that stands for it, else its newest. @param {string} id */
export function openDrive(id) {
  const jobs = lists.jobs.filter((each) => each.drive_id === id);
  const job = jobs.find(standing) ?? jobs[0];
  setState({ drive: id || null, job: job?.id ?? null, frame: null, view: null, panel: job ? "result" : "drives" });
}

/** @param {any} job */
export function openJob(job) {
  setState({ drive: job.drive_id, job: job.id, panel: "result", frame: null, view: null });
}

/** @returns {string} What becomes of a thing that is deleted: said before. */
export function afterDeletion() {
  const hours = getConfig().trash_h;
  return hours > 0
    ? `It can be restored from the trash for ${formatHours(hours)}.`
    : "This server keeps no trash: this cannot be undone.";
}

/** @param {number} hours @returns {string} "3 days", "5 h 30 min" */
export function formatHours(hours) {
  return hours >= 48 ? `${Math.round(hours / 24)} days` : formatDuration(3600 * hours);
}
