/**
 * What of a map of many drives is looked at: its intersections, and its findings. Map, queue and address follow it alike.
 */
import { getState, setState } from "../state.js";

/**
 * @typedef {object} CityFilter
 * @property {number|null} drives Least number of drives that saw an intersection.
 * @property {number|null} confidence Least, 0..1.
 * @property {"new"|"gone"|"changed"|null} change Only intersections that came, or went, or whose branches did.
 * @property {string|null} kind Of findings.
 * @property {"open"|"judged"|"all"} state Of findings.
 */

/** @type {Readonly<CityFilter>} */
const NONE = { drives: null, confidence: null, change: null, kind: null, state: "open" };
const NUMBERS = new Set(["drives", "confidence"]);
const WORDS = /** @type {Record<string, string[]>} */ ({
  change: ["new", "gone", "changed"],
  state: ["open", "judged", "all"],
});

/** @param {string|null} text "drives:2;change:new" @returns {CityFilter} Of what it understands; the rest is left out. */
export function parseCityFilter(text) {
  const filter = /** @type {any} */ ({ ...NONE });
  for (const part of text?.split(";") ?? []) {
    const [name, value = ""] = part.split(":");
    if (NUMBERS.has(name)) filter[name] = /^\d+(\.\d+)?$/.test(value) ? Number(value) : null;
    else if (WORDS[name]?.includes(value) || (name === "kind" && /^\w+$/.test(value))) filter[name] = value;
  }
  return filter;
}

/** @param {CityFilter} filter @returns {string|null} As in the address; null for none. */
export function formatCityFilter(filter) {
  const parts = Object.entries(filter).filter(([name, value]) => value !== /** @type {any} */ (NONE)[name]);
  return parts.map(([name, value]) => `${name}:${value}`).join(";") || null;
}

/** @returns {CityFilter} What the address says. */
export const getCityFilter = () => parseCityFilter(getState().places);

/** @param {Partial<CityFilter>} patch */
export const setCityFilter = (patch) => setState({ places: formatCityFilter({ ...getCityFilter(), ...patch }) });

/** @param {CityFilter} filter @returns {string|null} For the service, CQL2; null for all intersections. */
export function cqlOf({ drives, confidence }) {
  const parts = [drives !== null && `drives >= ${drives}`, confidence !== null && `confidence >= ${confidence}`];
  return parts.filter(Boolean).join(" AND ") || null;
}

/** @param {CityFilter} filter @param {{kind: string}} change @returns {boolean} Whether it is of the kind looked for. */
export const isOfChange = ({ change }, { kind }) => change === "changed" || kind.startsWith(`${change}_`);
