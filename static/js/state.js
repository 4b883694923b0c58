/** What the page shows: one small store. The part of it that makes a permalink lives in the address behind "#". */

/**
 * @typedef {object} State
 * @property {string} panel drives, map, upload, job, report, compare, export; an address that names none shows that of its job.
 * @property {string|null} drive Id of the drive that is shown.
 * @property {string|null} job Id of the job that is shown.
 * @property {number|null} frame Scan number of the keyframe that is shown.
 * @property {string|null} view Of the map: "zoom/lat/lon".
 * @property {string[]|null} layers Switched on; null for the usual ones.
 * @property {string[]|null} compare Ids of the jobs beside which the shown one is.
 * @property {boolean} drawer Whether the keyframe is shown at large.
 * @property {boolean} service Whether service roads count as roads of the map; it belongs to the job.
 * @property {string|null} intersection Id or uid of the intersection that is chosen; it belongs to the job.
 * @property {number|null} node OSM id of the node that is chosen; it belongs to the job too.
 * @property {string|null} live Id of the live session that is watched, in the place of a job.
 * @property {string|null} filter Which intersections of the job are looked at, see map/filter.js.
 * @property {string|null} map Id of the map of many drives; null for that of the server.
 * @property {string|null} finding Id of the finding of that map that is looked at.
 * @property {string|null} places Which intersections of that map are shown, see map/city_filter.js.
 */

/** @type {State} */
const initial = {
  panel: "drives",
  drive: null,
  job: null,
  frame: null,
  view: null,
  layers: null,
  compare: null,
  drawer: false,
  service: false,
  intersection: null,
  node: null,
  filter: null,
  live: null,
  map: null,
  finding: null,
  places: null,
};

/** @type {State} */
let state = { ...initial, ...parse(globalThis.location?.hash ?? "") };

/** @type {Set<{keys: string[]|null, call: (state: State, before: State) => void}>} */
const listeners = new Set();

/** @returns {Readonly<State>} */
export function getState() {
  return state;
}

/**
 * Change the state; listeners of what really changed are called.
 * @param {Partial<State>} patch
 */
export function setState(patch) {
  const before = state;
  const isOther = patch.job !== undefined && patch.job !== before.job;
  const leaves = patch.drive !== undefined && before.drive !== null && patch.drive !== before.drive;
  const next = {
    ...before,
    ...(isOther && { intersection: null, node: null, filter: null, service: false }),
    ...(leaves && { compare: null }), // they are of one drive
    ...((patch.job || patch.drive) && { live: null }),
    ...(patch.map !== undefined && patch.map !== before.map && { finding: null, places: null }),
    ...patch,
  };
  const changed = Object.keys(next).filter(
    (key) => !same(/** @type {any} */ (next)[key], /** @type {any} */ (before)[key]),
  );
  if (!changed.length) return;
  state = next;
  writeHash(changed.some((key) => ["panel", "job", "drive", "live", "map"].includes(key)));
  for (const { keys, call } of [...listeners]) {
    if (!keys || keys.some((key) => changed.includes(key))) call(state, before);
  }
}

/**
 * Call a function whenever one of the keys changes.
 * @param {string[]|null} keys null for any.
 * @param {(state: State, before: State) => void} call
 * @returns {() => void} Stops it.
 */
export function subscribe(keys, call) {
  const listener = { keys, call };
  listeners.add(listener);
  return () => listeners.delete(listener);
}

/** @param {Partial<State>} [patch] @returns {string} An address that shows what the page shows now, or would show. */
export function permalink(patch = {}) {
  const url = new URL(location.href);
  url.hash = format({ ...state, ...patch });
  return url.href;
}

/** @param {any} a @param {any} b */
function same(a, b) {
  return (
    a === b || (Array.isArray(a) && Array.isArray(b) && a.length === b.length && a.every((each, i) => each === b[i]))
  );
}

/** @param {State} shown @returns {string} */
function format(shown) {
  const parts = [];
  const { panel, compare, layers, drawer, service, ...texts } = shown;
  if (panel !== initial.panel || shown.job) parts.push(`panel=${encoded(panel)}`);
  for (const [key, value] of Object.entries(texts)) {
    if (value !== null && value !== /** @type {any} */ (initial)[key]) parts.push(`${key}=${encoded(String(value))}`);
  }
  if (compare) parts.push(`compare=${compare.map(encodeURIComponent).join(",")}`);
  if (layers) parts.push(`layers=${layers.join(",")}`);
  if (drawer) parts.push("drawer=1");
  if (service) parts.push("service=1");
  return parts.join("&");
}

/** @param {string} text @returns {string} For an address, with what may stand there as it is. */
const encoded = (text) => encodeURIComponent(text).replace(/%2F|%2C|%3A|%3B/g, decodeURIComponent);

/** @param {string} hash @returns {State} */
function parse(hash) {
  const fields = new URLSearchParams(hash.replace(/^#/, ""));
  /** @param {string} key */
  const integer = (key) => (/^-?\d+$/.test(fields.get(key) ?? "") ? Number(fields.get(key)) : null);
  const frame = integer("frame");
  const layers = fields.get("layers");
  const compare = fields.get("compare")?.split(",").filter(Boolean) ?? [];
  return {
    panel: fields.get("panel") ?? (fields.get("job") ? "job" : initial.panel),
    drive: fields.get("drive"),
    job: fields.get("job"),
    frame: frame !== null && frame >= 0 ? frame : null,
    view: fields.get("view"),
    layers: layers === null ? null : layers.split(",").filter(Boolean),
    compare: compare.length ? [...new Set(compare)] : null,
    drawer: fields.get("drawer") === "1",
    service: fields.get("service") === "1",
    intersection: fields.get("intersection") || null,
    node: integer("node"),
    filter: fields.get("filter") || null,
    live: fields.get("live") || null,
    map: fields.get("map") || null,
    finding: fields.get("finding") || null,
    places: fields.get("places") || null,
  };
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
  state = { ...initial, ...parse(location.hash) };
  for (const { call } of [...listeners]) call(state, before);
});
