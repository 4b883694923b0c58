/** What the page shows: one small store. The part of it that makes a permalink lives in the address behind "#". */
import { news } from "./news.js";

/**
 * @typedef {object} State
 * @property {string} panel drives, upload, result, map, compare, export; an address that names none shows the result of its job.
 * @property {string|null} drive Id of the drive that is shown.
 * @property {string|null} job Id of the job that is shown.
 * @property {number|null} frame Scan number of the keyframe that is shown.
 * @property {string|null} view Of the map: "zoom/lat/lon".
 * @property {string[]|null} layers Switched on; null for the usual ones.
 * @property {string[]|null} compare Ids of the jobs beside which the shown one is.
 * @property {boolean} drawer Whether the keyframe is shown at large.
 * @property {string|null} intersection Id or uid of the intersection that is chosen; it belongs to the job.
 * @property {string|null} node OSM id of the node that is chosen; it belongs to the job too.
 * @property {string|null} live Id of the live session that is watched, in the place of a job.
 * @property {string|null} filter By which words intersections of the job are looked at, see map/filter.js.
 * @property {string|null} map Id of the map of many drives; null for that of the server.
 * @property {string|null} finding Id of the finding of that map that is looked at.
 */

/** What may stand in an address as it is. @param {any} value */
const encoded = (value) => encodeURIComponent(String(value)).replace(/%2F|%2C|%3A|%3B/g, decodeURIComponent);

/** How a value stands in the address: null and false do not. */
const TEXT = { read: (/** @type {string} */ text) => text || null, write: encoded };
const NUMBER = { read: (/** @type {string} */ text) => (/^-?\d+$/.test(text) ? Number(text) : null), write: encoded };
const MARK = { read: (/** @type {string} */ text) => text === "1", write: () => "1" };
const LIST = {
  read: (/** @type {string} */ text) => [...new Set(text.split(",").filter(Boolean))],
  write: (/** @type {string[]} */ names) => names.map(encodeURIComponent).join(","),
};
/** @type {Record<keyof State, {read: (text: string) => any, write: (value: any) => string}>} */
const PARTS = {
  panel: TEXT,
  drive: TEXT,
  job: TEXT,
  frame: NUMBER,
  view: TEXT,
  intersection: TEXT,
  node: TEXT,
  filter: TEXT,
  live: TEXT,
  map: TEXT,
  finding: TEXT,
  compare: LIST,
  layers: LIST,
  drawer: MARK,
};
const USUAL_PANEL = "drives";

let state = parse(globalThis.location?.hash ?? "");

/** @type {ReturnType<typeof news<[changed: string[], before: State]>>} */
const changes = news();

/** @returns {Readonly<State>} */
export function getState() {
  return state;
}

/** Change the state; listeners of what really changed are called. @param {Partial<State>} patch */
export function setState(patch) {
  const before = state;
  const isOther = patch.job !== undefined && patch.job !== before.job;
  const leaves = patch.drive !== undefined && before.drive !== null && patch.drive !== before.drive;
  const next = {
    ...before,
    ...(isOther && { intersection: null, node: null, filter: null }),
    ...(leaves && { compare: null }), // they are of one drive
    ...((patch.job || patch.drive) && { live: null }),
    ...(patch.map !== undefined && patch.map !== before.map && { finding: null }),
    ...patch,
  };
  const changed = changedKeys(next, before);
  if (!changed.length) return;
  state = next;
  const steps = ["panel", "job", "live", "map", ...(next.job ? [] : ["drive"])]; // which drive a job is of is learnt
  writeHash(changed.some((key) => steps.includes(key)));
  changes.tell(changed, before);
}

/**
 * Call a function whenever one of the keys changes.
 * @param {string[]} keys
 * @param {(state: State, before: State) => void} call
 * @returns {() => void} Stops it.
 */
export function subscribe(keys, call) {
  return changes.hear((changed, before) => {
    if (keys.some((key) => changed.includes(key))) call(state, before); // it may have changed again
  });
}

/** @param {State} now @param {State} before @returns {string[]} */
function changedKeys(now, before) {
  const keys = /** @type {(keyof State)[]} */ (Object.keys(PARTS));
  return keys.filter((key) => JSON.stringify(now[key]) !== JSON.stringify(before[key]));
}

/** @param {State} shown */
function format(shown) {
  const said = Object.entries(shown).filter(([key, value]) =>
    key === "panel" ? value !== USUAL_PANEL || shown.job : value !== null && value !== false,
  );
  return said.map(([key, value]) => `${key}=${PARTS[/** @type {keyof State} */ (key)].write(value)}`).join("&");
}

/** @param {string} hash @returns {State} */
function parse(hash) {
  const fields = new URLSearchParams(hash.replace(/^#/, ""));
  const read = Object.entries(PARTS).map(([key, part]) => [key, part.read(fields.get(key) ?? "")]);
  const state = Object.fromEntries(read);
  state.panel ??= state.job ? "result" : USUAL_PANEL;
  if (["job", "report"].includes(state.panel)) state.panel = "result"; // as older links say
  if (state.frame < 0) state.frame = null;
  if (!state.compare.length) state.compare = null;
  if (!fields.has("layers")) state.layers = null; // the usual ones; "layers=" is none
  return state;
}

/** @param {boolean} step True where "back" should undo it. */
function writeHash(step) {
  const hash = `#${format(state)}`;
  if (hash === location.hash || (hash === "#" && !location.hash)) return;
  if (step) history.pushState(null, "", hash);
  else history.replaceState(null, "", hash);
}

globalThis.addEventListener?.("popstate", () => {
  const before = state;
  state = parse(location.hash);
  changes.tell(changedKeys(state, before), before);
});
