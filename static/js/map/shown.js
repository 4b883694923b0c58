/**
 * What is on the map: a small store between the map and all that follows it.
 * @module map/shown
 */

/** @typedef {import("../data/results.js").Result} Result */

/** @type {{result: Result|null, map: any}} `map`: of Leaflet; null until there is something to show. */
export const shown = { result: null, map: null };

/** @type {Set<(result: Result|null) => void>} */
const listeners = new Set();

/** @param {(result: Result|null) => void} call Called now and whenever another result is shown. */
export function onResult(call) {
  listeners.add(call);
  call(shown.result);
}

/** @param {Result|null} result */
export function setResult(result) {
  shown.result = result;
  for (const call of listeners) call(result);
}

/** @param {Result|null} result @returns {number|null} The keyframe of the first detection: there is something to see. */
export function firstDetection(result) {
  return result?.detections[0]?.properties.frame ?? result?.keyframes[0]?.properties.frame ?? null;
}
