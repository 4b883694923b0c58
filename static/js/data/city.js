/** Maps of many drives, and the queue of what OpenStreetMap seems to have wrong by one of them: as last received. */
import { ApiError, getJson, keepLooking, sendJson } from "../api.js";
import { news } from "../news.js";
import { getState, setState, subscribe } from "../state.js";

/**
 * @typedef {{id: string, name: string, holds_all: boolean, revision: number, merged_at: string|null, is_waiting: boolean,
 *   is_at_work: boolean, drives: number, refused: number, intersections: number, seen_by_several: number, findings: number|null,
 *   median_position_std_m: number|null, junctions_passed: number|null, osm: string|null, problem: string|null,
 *   bbox: number[]|null, is_made_up: boolean}} City A map of many drives.
 * @typedef {"right"|"wrong"|"cannot_tell"|"fixed"} Verdict
 * @typedef {{finding: string, verdict: Verdict, by: string, at: string, note: string|null}} Judgement
 * @typedef {{id: string, kind: string, lon: number, lat: number, properties: any, verdict: Judgement|null,
 *   picture: string|null, links: Record<string, string>, history?: Judgement[]}} Entry A finding.
 * @typedef {{right: number, wrong: number, cannot_tell: number, share: number|null, low: number|null,
 *   high: number|null}} Precision
 * @typedef {{drive_id: string, name: string|null, label: string|null, job_id: string|null, problem: string|null}} Member
 */

/** What is known of the maps. `queue`: of the one that is shown, as far as it was read. */
export const cities = {
  /** @type {City[]|null} null: nobody has asked yet. */
  maps: null,
  /** @type {{map: string, entries: Entry[], open: number, judged: number, precision: Precision,
   *   by_kind: Record<string, Precision>, next: string|null}|null} */
  queue: null,
  /** Which findings the queue shows; `kind` "" is all. */
  wanted: { state: "open", kind: "" },
  /** @type {Entry|null} The finding that is looked at. */
  entry: null,
  /** What was said of findings, by their ids: of the last thousand, and of all that were judged here. @type {Map<string, Verdict>} */
  verdicts: new Map(),
  /** Whether the token may only read, as the server has said. */
  readsOnly: false,
};

const SERVER_MAP = "default";
const PAGE = 50;
const LOOK_MS = 10000;
const WAITING_MS = 1500; // between looks while drives are merged

const changes = news();
export const onCityChange = changes.hear;
/** Findings that were judged here, as the server had them then, the last one last. @type {Entry[]} */
const judgedHere = [];

/** @returns {City|null} The map that is shown, or would be. */
export const chosenCity = () => cities.maps?.find(({ id }) => id === (getState().map ?? SERVER_MAP)) ?? null;

/** @param {City} city @returns {string} Differs where something of it does. */
export const versionOf = ({ id, revision, is_waiting, findings, bbox }) =>
  [id, revision, is_waiting, findings, bbox].join();

/** @returns {boolean} Whether a map of many drives is what the page shows, or would. */
export function wantsCity() {
  const { panel, job, drive, live } = getState();
  return panel === "map" || (!job && !drive && !live);
}

/** Ask for the maps again. */
export function loadMaps() {
  asking ??= readMaps().finally(() => (asking = null));
  return asking;
}
/** Whoever asks meanwhile gets the same answer. @type {Promise<void>|null} */
let asking = null;

async function readMaps() {
  const maps = await all("maps", "maps", 100);
  const isFirst = cities.maps === null;
  const isSame = JSON.stringify(maps) === JSON.stringify(cities.maps);
  cities.maps = maps;
  if (!isSame) changes.tell();
  if (isFirst) void loadEntry();
}

/** Keep the maps up to date while one is looked at: often while its drives are merged. */
export function watchMaps() {
  const wait = () => (chosenCity()?.is_waiting ? WAITING_MS : LOOK_MS);
  const plan = keepLooking(wait, async () => {
    if (wantsCity()) await loadMaps();
  });
  onCityChange(plan);
  subscribe(["map"], plan);
}

/**
 * Features of a layer within a box.
 * @param {string} map Id.
 * @param {"city"|"drives"|"changes"|"findings"} layer
 * @param {number[]} box West, south, east, north.
 * @param {{limit: number, signal?: AbortSignal}} options
 * @returns {Promise<{features: any[], matched: number}>}
 */
export async function featuresIn(map, layer, box, { limit, signal }) {
  const fields = { bbox: box.map((each) => each.toFixed(6)).join(), limit: String(limit) };
  const path = `maps/${map}/ogc/collections/${layer}/items?${new URLSearchParams(fields)}`;
  const page = await getJson(path, { signal, headers: { Accept: "application/geo+json" } });
  return { features: page.features, matched: page.numberMatched };
}

/** @param {string} map Id. @returns {Promise<Member[]>} All drives that belong to it. */
export const loadMembers = (map) => all(`maps/${map}/drives`, "drives", 1000);

/** @param {string} path Of a list. @param {string} member That holds its entries. @param {number} limit Of a page. @returns {Promise<any[]>} */
async function all(path, member, limit) {
  const found = [];
  for (let after = ""; ; ) {
    const page = await getJson(`${path}?limit=${limit}${after && `&after=${after}`}`);
    found.push(...page[member]);
    if (!page.next) return found;
    after = page.next;
  }
}

/** Read what was said of the findings of a map. @param {string} map Id. */
export async function loadVerdicts(map) {
  const { entries } = await getJson(`maps/${map}/queue?state=judged&limit=1000`);
  cities.verdicts = new Map(entries.map((/** @type {Entry} */ { id, verdict }) => [id, verdict?.verdict]));
}

/**
 * Read the queue of a map, from its begin or on from where it was read.
 * @param {City} city
 * @param {boolean} [isMore]
 */
export async function loadQueue({ id }, isMore = false) {
  const mine = ++queueAsked;
  const { state, kind } = cities.wanted;
  const before = isMore ? cities.queue : null;
  const fields = { state, limit: String(PAGE), ...(kind && { kind }), ...(before?.next && { after: before.next }) };
  const page = await getJson(`maps/${id}/queue?${new URLSearchParams(fields)}`);
  if (mine !== queueAsked) return;
  cities.queue = { ...page, map: id, entries: [...(before?.entries ?? []), ...page.entries] };
  changes.tell();
}
let queueAsked = 0;

/** Read the finding that the address names. */
async function loadEntry() {
  const { finding } = getState();
  const city = chosenCity();
  if (!finding) cities.entry = null;
  else if (city) {
    cities.entry = cities.queue?.entries.find(({ id }) => id === finding) ?? null; // at once, as the list has it
    changes.tell();
    const whole = await getJson(entryPath(finding));
    if (finding !== getState().finding) return;
    cities.entry = whole;
  }
  changes.tell();
}

/** @param {string} finding @returns {string} Its address. */
const entryPath = (finding) => `maps/${chosenCity()?.id}/queue/${encodeURIComponent(finding)}`;

/**
 * Go to the next or the previous finding of those of the list that were read.
 * @param {1|-1} by
 * @param {(entry: Entry) => boolean} [isWanted]
 */
export async function stepFinding(by, isWanted = () => true) {
  const entries = cities.queue?.entries ?? [];
  const at = entries.findIndex(({ id }) => id === getState().finding);
  const from = at < 0 && by < 0 ? entries.length : at;
  const some = by > 0 ? entries.slice(from + 1) : entries.slice(0, from).reverse();
  const next = some.find(isWanted);
  if (next) setState({ finding: next.id });
}

/** Say what was seen at the finding that is looked at, and go to the next one that is open. @param {Verdict} verdict */
export async function judge(verdict) {
  const { finding } = getState();
  if (!finding) return;
  const judged = await change(() => sendJson("PUT", `${entryPath(finding)}/verdict`, { verdict }));
  judgedHere.push(judged);
  keepEntry(judged);
  if (finding === getState().finding) await stepFinding(1, (each) => !each.verdict);
  await countAgain();
}

/** Take the last verdict back: of the finding that is looked at, else of that which was judged last. */
export async function takeBack() {
  const known = cities.entry?.verdict ? cities.entry : judgedHere.at(-1);
  const city = chosenCity();
  if (!known || !city) return;
  const finding = known.id;
  const path = entryPath(finding);
  const now = await getJson(path);
  if (now.verdict?.at !== known.verdict?.at) {
    keepEntry(now);
    setState({ finding });
    throw new ApiError(409, { title: "Not taken back", detail: "Somebody has said something since: it is shown now." });
  }
  await change(() => sendJson("DELETE", `${path}/verdict`));
  const at = judgedHere.findLastIndex(({ id }) => id === finding);
  if (at >= 0) judgedHere.splice(at, 1);
  try {
    keepEntry(await getJson(path));
  } catch (error) {
    if (!(error instanceof ApiError && error.status === 404)) throw error;
    keepEntry({ ...now, verdict: null, history: [] }); // it comes back with the next comparison
  }
  setState({ finding });
  await countAgain();
  await loadMaps(); // that it is compared anew is seen, and its end
}

/** @template T @param {() => Promise<T>} send */
async function change(send) {
  try {
    return await send();
  } catch (error) {
    if (error instanceof ApiError && error.status === 403) {
      cities.readsOnly = true;
      changes.tell();
    }
    throw error;
  }
}

/** @param {Entry} entry As just received. */
function keepEntry(entry) {
  if (entry.verdict) cities.verdicts.set(entry.id, entry.verdict.verdict);
  else cities.verdicts.delete(entry.id);
  if (cities.entry?.id === entry.id) cities.entry = entry;
  if (cities.queue)
    cities.queue.entries = cities.queue.entries.map((each) =>
      each.id === entry.id ? { ...entry, properties: entry.properties ?? each.properties } : each,
    );
  changes.tell();
}

/** Read the figures of the queue again: the list stays as it is until it is asked for anew. */
async function countAgain() {
  const { queue } = cities;
  if (!queue) return;
  const { open, judged, precision, by_kind } = await getJson(`maps/${queue.map}/queue?limit=1`);
  Object.assign(queue, { open, judged, precision, by_kind });
  changes.tell();
}

subscribe(["map"], () => void (judgedHere.length = 0));
subscribe(["finding", "map"], () => void loadEntry());
