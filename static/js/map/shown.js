/** What is on the map: a small store between the map and all that follows it. */
import { news } from "../news.js";

/** @import { Result } from "../data/results.js" */
/**
 * @typedef {object} Preview Of a drive that is to be sent, or is being sent.
 * @property {Result} result Its track, where its scans were taken, and the roads of its map.
 * @property {string} title
 * @property {string} text
 * @property {number} progress How much of it was sent, 0..1.
 */

/**
 * @type {{result: Result|null, preview: Preview|null, map: any}} `map`: of Leaflet; null until there is something to
 *   show.
 */
export const shown = { result: null, preview: null, map: null };

/** @type {ReturnType<typeof news<[Result|null]>>} */
const results = news();
const previews = news();
/** Called whenever there is another preview, or news of it. */
export const onPreview = previews.hear;

/** @param {(result: Result|null) => void} call Called now and whenever another result is shown. */
export function onResult(call) {
  results.hear(call);
  call(shown.result);
}

/** @param {Result|null} result */
export function setResult(result) {
  shown.result = result;
  results.tell(result);
}

/** @param {Preview|null} preview */
export function setPreview(preview) {
  if (preview === null && shown.preview === null) return;
  shown.preview = preview;
  previews.tell();
}

/** @param {Result|null} result @returns {number|null} The keyframe of the first detection: there is something to see. */
export function firstDetection(result) {
  return result?.detections[0]?.properties.frame ?? result?.keyframes[0]?.properties.frame ?? null;
}
