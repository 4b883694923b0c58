/** The drives and jobs of the server, as last received: shared by all panels. */
import { getJson, keepLooking, sleep } from "../api.js";
import { groupBy } from "../dom.js";
import { news } from "../news.js";

/**
 * @type {{drives: any[], jobs: any[], isLoaded: boolean, isWhole: boolean, isCut: boolean}} The newest first. `isLoaded`:
 *   the newest of them are there; `isWhole`: so are all others, as far as the page reads them; `isCut`: the server has
 *   more drives than that.
 */
export const lists = { drives: [], jobs: [], isLoaded: false, isWhole: false, isCut: false };

/** What the folders of labels hold. */
export const LABEL_FOLDERS = /** @type {Record<string, string>} */ ({
  labels: "labels (by hand)",
  predictions: "predictions (of a network)",
  geometry: "geometry (of the points and the path driven)",
});

/** States of a job that has ended. */
export const FINAL = new Set(["successful", "failed", "dismissed"]);

const MAX_ROWS = 2000;
const HEAD_ROWS = 100; // what a look asks for: all there is on most servers
const PAGE_ROWS = 1000;
const LOOK_MS = 10000; // between looks for what others did; two short exchanges while nothing has changed
const FRESH_MS = 2000;
const WHOLE_LOOKS = 6; // every so many looks at everything: what was done to old rows

const changes = news();
export const onListsChange = changes.hear;

const PATIENCE_MS = 1500;
let tellThatMapIsSeen = () => {};
/** What the page shows first is the map: what else it asks for at its start waits for that, but not long. */
export const mapIsSeen = Promise.race([
  new Promise((/** @type {(value: void) => void} */ resolve) => (tellThatMapIsSeen = resolve)),
  sleep(PATIENCE_MS),
]);
export { tellThatMapIsSeen };

/** When the lists were last asked for. */
let askedAt = -Infinity;
/** Number of the last request for the lists, and of that whose answer is shown. */
let asked = 0;
let shown = 0;
/** Number of drives and jobs that were made here: an answer may not know them yet. */
let made = 0;

/** Ids of the drives whose jobs have several maps; null: to be found. @type {Set<string> | null} */
let withMaps = null;

/** The newest rows as last received, to see whether anything has happened. */
let headsShown = "";

/**
 * Ask the server again.
 * @param {boolean} [isLook] Whether the older rows may stay as they are where nothing has happened to the newest.
 */
export async function refreshLists(isLook = false) {
  const mine = ++asked;
  askedAt = performance.now();
  const before = made;
  const heads = await Promise.all([readHead("drives"), readHead("jobs")]);
  const now = JSON.stringify(heads);
  if (isLook && lists.isWhole && now === headsShown && heads.some(({ next }) => next)) return;
  if (!lists.isLoaded) showRows(heads, false);
  const pages = await Promise.all(heads.map(readRest));
  if (mine < shown) return; // one that was asked for later was faster
  if (made > before) return refreshLists();
  shown = mine;
  headsShown = now;
  lists.isCut = pages[0].next !== null;
  showRows(pages, true);
}

/** A look of those below that is under way: it may fail for all who wait for it. @type {Promise<void>|null} */
let looked = null;
/** Ask the server again, where the lists are not those of just now. */
export async function refreshOldLists() {
  await mapIsSeen;
  if (performance.now() - askedAt > FRESH_MS) looked = refreshLists().finally(() => (looked = null));
  await looked;
}

/** Keep the lists up to date with what other tabs and programs do, while somebody looks at the page. */
export function watchLists() {
  let looks = 0;
  keepLooking(LOOK_MS, async () => {
    looks += 1;
    await refreshLists(looks % WHOLE_LOOKS !== 0);
  });
}

/** @param {Rows[]} parts Drives, jobs. @param {boolean} isWhole */
function showRows([{ rows: drives }, { rows: received }], isWhole) {
  const jobs = received.map(newer);
  if (lists.isWhole && JSON.stringify([drives, jobs]) === JSON.stringify([lists.drives, lists.jobs])) return;
  Object.assign(lists, { drives, jobs, isLoaded: true, isWhole }); // nothing is drawn anew while nothing happens
  notify();
}

/** @param {any} job @returns {any} The newer of it as received and as it is known. */
function newer(job) {
  const known = lists.jobs.find((each) => each.id === job.id);
  return known && known.version > job.version ? known : job;
}

/** @param {any} job A job as just received. @returns {any} The newest that is known of it, which is kept. */
export function rememberJob(job) {
  const newest = newer(job);
  remember(lists.jobs, newest);
  return newest;
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

/** @param {any} job @returns {string} What it is called, with its map where the jobs of its drive have several. */
export function titleOf({ title, name, drive_id, request }) {
  const file = request.osm?.file;
  if (name || !file) return title;
  withMaps ??= drivesWithMaps();
  return withMaps.has(drive_id) ? `${title}, ${file}` : title;
}

/** @returns {Set<string>} Ids of the drives whose jobs have several maps. */
function drivesWithMaps() {
  const scored = lists.jobs.filter(({ request }) => request.osm?.file);
  const drives = [...groupBy(scored, (job) => job.drive_id)];
  return new Set(
    drives.filter(([, jobs]) => new Set(jobs.map(({ request }) => request.osm.file)).size > 1).map(([id]) => id),
  );
}

function notify() {
  withMaps = null;
  changes.tell();
}

/** @typedef {{path: "drives"|"jobs", rows: any[], next: string|null}} Rows */

/** @param {"drives"|"jobs"} path @returns {Promise<Rows>} The newest rows. */
async function readHead(path) {
  const page = await getJson(`${path}?limit=${HEAD_ROWS}`);
  return { path, rows: page[path], next: page.next };
}

/** @param {Rows} head @returns {Promise<Rows>} All rows, as far as the page reads them. */
async function readRest({ path, rows, next }) {
  const all = [...rows];
  while (next && all.length < MAX_ROWS) {
    const limit = Math.min(PAGE_ROWS, MAX_ROWS - all.length);
    const page = await getJson(`${path}?limit=${limit}&after=${encodeURIComponent(next)}`);
    all.push(...page[path]);
    next = page.next;
  }
  return { path, rows: all, next };
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
