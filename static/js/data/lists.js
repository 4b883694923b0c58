/**
 * The drives, jobs and trash of the server, as last received: shared by header and panels.
 * @module data/lists
 */
import { ApiError, getJson } from "../api.js";

/** @type {{drives: any[], jobs: any[], trash: any[], isLoaded: boolean}} */
export const lists = { drives: [], jobs: [], trash: [], isLoaded: false };

/** What the folders of labels hold. */
export const LABEL_FOLDERS = /** @type {Record<string, string>} */ ({
  labels: "labels (by hand)",
  predictions: "predictions (of a network)",
});

const MAX_ROWS = 500;
const LOOK_MS = 10000; // between looks for what others did; three short exchanges while nothing has changed
const MAX_TRIES = 3;

/** @type {Set<() => void>} */
const listeners = new Set();

/** @param {() => void} call */
export function onListsChange(call) {
  listeners.add(call);
}

/** Number of the last request for the lists, and of that whose answer is shown. */
let asked = 0;
let shown = 0;
/** Number of drives and jobs that were made here: an answer may not know them yet. */
let made = 0;

/** Ask the server again. */
export async function refreshLists() {
  const mine = ++asked;
  for (let tries = 1; ; tries += 1) {
    const before = made;
    const [drives, jobs, trash] = await Promise.all([
      readPages("drives", "drives"),
      readPages("jobs", "jobs"),
      readPages("trash", "items"),
    ]);
    if (mine < shown) return; // one that was asked for later was faster
    if (made > before && tries < MAX_TRIES) continue;
    shown = mine;
    show({ drives, jobs: jobs.map(newer), trash });
    return;
  }
}

/** Keep the lists up to date with what other tabs and programs do, while somebody looks at the page. */
export function watchLists() {
  let timer = 0;
  const look = async () => {
    clearTimeout(timer);
    if (document.hidden) return;
    try {
      if (lists.isLoaded) await refreshLists();
    } catch (error) {
      if (error instanceof ApiError && error.status === 401) return; // the person was asked for a token just now
    }
    clearTimeout(timer);
    timer = setTimeout(look, LOOK_MS);
  };
  document.addEventListener("visibilitychange", () => void look());
  timer = setTimeout(look, LOOK_MS);
}

/** @param {{drives: any[], jobs: any[], trash: any[]}} received */
function show(received) {
  const { drives, jobs, trash } = lists;
  const isSame = lists.isLoaded && JSON.stringify(received) === JSON.stringify({ drives, jobs, trash });
  if (isSame) return; // nothing is drawn anew while nothing happens
  Object.assign(lists, received, { isLoaded: true });
  notify();
}

/** @param {any} job @returns {any} The job as its events told it, where they were faster than the list. */
function newer(job) {
  const known = lists.jobs.find((each) => each.id === job.id);
  return known && known.version > job.version ? known : job;
}

/** @param {any} job A job as just received: takes the place of the older one. */
export function rememberJob(job) {
  remember(lists.jobs, job);
}

/** @param {any} drive */
export function rememberDrive(drive) {
  remember(lists.drives, drive);
}

/** @param {any[]} rows @param {any} item */
function remember(rows, item) {
  const row = rows.findIndex((each) => each.id === item.id);
  if (row < 0) {
    rows.unshift(item);
    made += 1;
  } else rows[row] = item;
  notify();
}

function notify() {
  for (const call of listeners) call();
}

/** @param {string} path @param {string} member @returns {Promise<any[]>} */
async function readPages(path, member) {
  const rows = [];
  let after = null;
  do {
    const page = await getJson(`${path}?limit=100${after ? `&after=${encodeURIComponent(after)}` : ""}`);
    rows.push(...page[member]);
    after = page.next;
  } while (after && rows.length < MAX_ROWS);
  return rows;
}

/** @param {any} config @param {string} [prefix] @returns {Map<string, any>} Values by path: "bev.resolution_m". */
export function flatten(config, prefix = "") {
  /** @type {Map<string, any>} */
  const all = new Map();
  for (const [name, value] of Object.entries(config)) {
    const path = prefix + name;
    if (value === null || typeof value !== "object" || Array.isArray(value)) all.set(path, value);
    else for (const [inner, leaf] of flatten(value, `${path}.`)) all.set(inner, leaf);
  }
  return all;
}
