/**
 * The drives and jobs of the server, as last heard: shared by header and panels.
 * @module data/lists
 */
import { getJson } from "../api.js";

/** @type {{drives: any[], jobs: any[], isLoaded: boolean, more: boolean}} */
export const lists = { drives: [], jobs: [], isLoaded: false, more: false };

const MOST = 500;

/** @type {Set<() => void>} */
const listeners = new Set();

/** @param {() => void} call */
export function onListsChange(call) {
  listeners.add(call);
}

/** Ask the server again. */
export async function refreshLists() {
  const [drives, jobs] = await Promise.all([pages("drives", "drives"), pages("jobs", "jobs")]);
  lists.drives = drives;
  lists.jobs = jobs;
  lists.isLoaded = true;
  changed();
}

/** @param {any} job A job as just heard of: takes the place of the older one. */
export function rememberJob(job) {
  const row = lists.jobs.findIndex((each) => each.id === job.id);
  if (row < 0) lists.jobs.unshift(job);
  else lists.jobs[row] = job;
  changed();
}

/** @param {any} drive */
export function rememberDrive(drive) {
  const row = lists.drives.findIndex((each) => each.id === drive.id);
  if (row < 0) lists.drives.unshift(drive);
  else lists.drives[row] = drive;
  changed();
}

/** Let everybody show the lists again, since something that they are shown with is known now. */
export function touchLists() {
  if (lists.isLoaded) changed();
}

function changed() {
  for (const call of listeners) call();
}

/** @param {string} path @param {string} member @returns {Promise<any[]>} */
async function pages(path, member) {
  const rows = [];
  let after = null;
  do {
    const page = await getJson(`${path}?limit=100${after ? `&after=${encodeURIComponent(after)}` : ""}`);
    rows.push(...page[member]);
    after = page.next;
  } while (after && rows.length < MOST);
  return rows;
}
