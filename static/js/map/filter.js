/**
 * Which intersections are looked at: by verdict, by figures, by words. List and map follow it alike.
 * @module map/filter
 */
import { verdictOf } from "./layers.js";

/** @typedef {import("../data/results.js").Place} Place */
/** @typedef {"confidence"|"observations"|"position_std_m"} Figure */
/**
 * @typedef {object} Filter
 * @property {string[]|null} verdicts null for any.
 * @property {string} words An id, a uid, or a part of the uid or of the reason.
 * @property {Partial<Record<Figure, [least: number|null, most: number|null]>>} ranges
 */

/** @type {Filter} */
const NONE = { verdicts: null, words: "", ranges: {} };

/** @type {Filter} */
let filter = NONE;
/** @type {Set<() => void>} */
const listeners = new Set();

/** @returns {Readonly<Filter>} */
export const getFilter = () => filter;

/** @param {Partial<Filter>} patch */
export function setFilter(patch) {
  filter = { ...filter, ...patch };
  for (const call of [...listeners]) call();
}

/** Look at all intersections again. */
export const clearFilter = () => setFilter(NONE);

/** @param {() => void} call @returns {() => void} Stops it. */
export function onFilterChange(call) {
  listeners.add(call);
  return () => listeners.delete(call);
}

/** @param {Place} intersection @returns {boolean} */
export const passes = (intersection) => matches(filter, intersection);

/** @returns {boolean} Whether something may be left out. */
export function isFiltering() {
  const isSet = Object.values(filter.ranges).some((range) => range.some((bound) => bound !== null));
  return filter.verdicts !== null || filter.words.trim() !== "" || isSet;
}

/** @param {Filter} wanted @param {Place} intersection @returns {boolean} */
export function matches({ verdicts, words, ranges }, intersection) {
  const { properties: p } = intersection;
  if (verdicts && !verdicts.includes(verdictOf(intersection))) return false;
  for (const [name, [least, most]] of Object.entries(ranges)) {
    const value = p[name];
    if ((least !== null && !(value >= least)) || (most !== null && !(value <= most))) return false;
  }
  const text = words.trim().toLowerCase();
  return !text || isCalled(text, p);
}

/** @param {string} text In lower case. @param {any} properties @returns {boolean} */
function isCalled(text, { id, osm_id, uid, reason }) {
  if (/^\d+$/.test(text)) return text === String(id) || text === String(osm_id) || `n${text}` === uid;
  return [uid, reason].some((each) => each?.toLowerCase().includes(text));
}
