/** Which intersections are looked at, by words: list, map and address follow it alike. */
import { getState, setState, subscribe } from "../state.js";

/** @param {string} words An id, a uid, a street, or a part of the uid or of the reason. */
export const setFilter = (words) => setState({ filter: words || null });

/** @param {() => void} call @returns {() => void} Stops it. */
export const onFilterChange = (call) => subscribe(["filter", "job"], call);

/** @param {import("../data/results.js").Place} intersection */
export const passes = ({ properties }) => matches(getState().filter ?? "", properties);

/** @param {string} words @param {any} properties Of an intersection. */
export function matches(words, { id, osm_id, uid, reason, names }) {
  const text = words.trim().toLowerCase();
  if (/^\d+$/.test(text)) return text === String(id) || text === String(osm_id) || `n${text}` === uid;
  return !text || [uid, reason, names].some((each) => each?.toLowerCase().includes(text));
}
