/** Which intersections are looked at: by verdict, by figures, by words. List, map and address follow it alike. */
import { getState, setState, subscribe } from "../state.js";
import { VERDICTS, verdictOf } from "./layers.js";

/** @import { Place } from "../data/results.js" */
/** @typedef {"confidence"|"observations"|"position_std_m"} Figure */
/**
 * @typedef {object} Filter
 * @property {string[]|null} verdicts null for any.
 * @property {string} words An id, a uid, or a part of the uid or of the reason.
 * @property {Partial<Record<Figure, [least: number|null, most: number|null]>>} ranges
 */

/** @type {Filter} */
const NONE = { verdicts: null, words: "", ranges: {} };

/** Names of the figures in the address. */
const FIGURES = /** @type {Record<string, Figure>} */ ({
  confidence: "confidence",
  observations: "observations",
  uncertainty_m: "position_std_m",
});

/** @type {{text: string|null, filter: Filter}} */
let last = { text: null, filter: NONE };

/** @returns {Readonly<Filter>} What the address says. */
export function getFilter() {
  const text = getState().filter;
  if (text !== last.text) last = { text, filter: parseFilter(text ?? "") };
  return last.filter;
}

/** @param {Partial<Filter>} patch */
export const setFilter = (patch) => setState({ filter: formatFilter({ ...getFilter(), ...patch }) });

/** Look at all intersections again. */
export const clearFilter = () => setState({ filter: null });

/** @param {() => void} call @returns {() => void} Stops it. */
export const onFilterChange = (call) => subscribe(["filter"], call);

/** @param {Place} intersection */
export const passes = (intersection) => matches(getFilter(), intersection);

/** @returns {boolean} Whether something may be left out. */
export const isFiltering = () => getState().filter !== null && formatFilter(getFilter()) !== null;

/**
 * @param {Filter} wanted
 * @returns {string|null} As in the address: "outcome:wrong,unscored;confidence:0.5..;find:worth a look"; null for none.
 */
export function formatFilter({ verdicts, words, ranges }) {
  const parts = [];
  if (verdicts) parts.push(`outcome:${verdicts.join(",") || "none"}`);
  for (const [name, figure] of Object.entries(FIGURES)) {
    const [least, most] = ranges[figure] ?? [null, null];
    if (least !== null || most !== null) parts.push(`${name}:${least ?? ""}..${most ?? ""}`);
  }
  if (words.trim()) parts.push(`find:${words}`); // last, since words may hold anything
  return parts.join(";") || null;
}

/** @param {string} text @returns {Filter} Of what it understands; the rest is left out. */
export function parseFilter(text) {
  const [, before, words = ""] = /^(.*?)(?:(?:^|;)find:(.*))?$/s.exec(text) ?? ["", text];
  /** @type {Filter} */
  const filter = { verdicts: null, words, ranges: {} };
  for (const part of before.split(";")) {
    const [name, value = ""] = part.split(":");
    const bounds = /^(\d+(?:\.\d+)?)?\.\.(\d+(?:\.\d+)?)?$/.exec(value);
    if (name === "outcome") {
      const known = Object.keys(VERDICTS).filter((each) => value.split(",").includes(each));
      filter.verdicts = known.length || value === "none" ? known : null;
    } else if (bounds && Object.hasOwn(FIGURES, name)) {
      const [least, most] = bounds.slice(1).map((bound) => (bound === undefined ? null : Number(bound)));
      filter.ranges[FIGURES[name]] = [least, most];
    }
  }
  return filter;
}

/** @param {Filter} wanted @param {Place} intersection */
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

/** @param {string} text In lower case. @param {any} properties */
function isCalled(text, { id, osm_id, uid, reason, names }) {
  if (/^\d+$/.test(text)) return text === String(id) || text === String(osm_id) || `n${text}` === uid;
  return [uid, reason, names].some((each) => each?.toLowerCase().includes(text));
}
