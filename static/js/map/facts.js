/**
 * What is known of a thing on the map, in words: its verdict first.
 * @module map/facts
 */
import { medianError } from "../data/results.js";
import { el, formatDuration, formatMetres, formatPercent, plural } from "../dom.js";
import { kindOfNode, verdictOf } from "./layers.js";
import { coordinates } from "./links.js";

/** @typedef {import("./scene.js").Hit} Hit */
/** @typedef {import("../data/results.js").Result} Result */

const VERDICTS = { right: ": right", wrong: ": wrong", unscored: "" };
const NODES = { found: "found", missed: "missed", outside: "out of reach" };
const DETECTIONS = /** @type {Record<string, string>} */ ({
  none: "Detection",
  TP: "True detection",
  FP: "False detection",
});

/** @param {Hit} hit @returns {string|null} The name of its sign; null for keyframes. */
export function signOf({ kind, item }) {
  if (kind === "intersection") return verdictOf(item);
  if (kind === "node") return kindOfNode(item);
  return kind === "detection" ? { TP: "tp", FP: "fp", none: "detection" }[/** @type {"TP"} */ (item.outcome)] : null;
}

/** @param {Hit} hit @returns {string} */
export function titleOf({ kind, item }) {
  if (kind === "intersection") return `Intersection ${item.properties.id}${VERDICTS[verdictOf(item)]}`;
  if (kind === "node") return `OSM intersection: ${NODES[kindOfNode(item)]}`;
  return kind === "detection" ? DETECTIONS[item.outcome] : `Keyframe at scan ${item.properties.frame}`;
}

/** @param {Hit} hit @returns {string} One line below the title. */
export function summaryOf({ kind, item }) {
  const { properties: p } = item;
  if (kind === "detection") {
    return `scan ${p.frame}${item.error_m === null ? "" : `, ${formatMetres(item.error_m)} from the OSM intersection`}`;
  }
  const detections = plural(p.observations ?? p.detections, "detection");
  if (kind === "intersection") {
    return `${detections}, ±${formatMetres(p.position_std_m)}, ${plural(p.branch_count, "branch", "branches")}`;
  }
  if (kind === "keyframe") return p.detections ? detections : "no detections";
  return p.detections ? `${detections} matched to it` : "no detection was matched to it";
}

/**
 * Why it is right, wrong, found, missed.
 * @param {Hit} hit
 * @param {Result} result
 * @returns {any} What goes into a paragraph; null where there is no verdict.
 */
export function whyOf({ kind, item }, result) {
  const { properties: p } = item;
  if (kind === "keyframe") return null;
  if (kind === "node") {
    if (p.reason) return sentence(p.reason);
    return kindOfNode(item) === "outside" ? "In the relevant zone of no keyframe: it does not count." : null;
  }
  const { error_m, osm_id } = kind === "detection" ? item : p;
  const isRight = kind === "detection" ? item.outcome === "TP" : verdictOf(item) === "right";
  if (isRight) return el("span", {}, `${formatMetres(error_m)} from OSM node `, osmLink(osm_id, result), ".");
  if (p.reason) return sentence(p.reason);
  if (item.outcome !== "FP") return null;
  return error_m === null ? "No OSM intersection in its region of interest." : null;
}

/** @param {string} text @returns {string} */
const sentence = (text) => `${text[0].toUpperCase()}${text.slice(1)}.`;

/**
 * All that is known of it.
 * @param {Hit} hit
 * @param {Result} result
 * @returns {Array<[string, any]|false>}
 */
export function factsOf({ kind, item }, result) {
  const { local } = result;
  const { properties: p } = item;
  /** @type {() => [string, any]} */
  const branches = () => [`Branches (${p.branch_count})`, bearings(p.branch_bearings_deg, local)];
  const ahead = `${formatMetres(Math.abs(p.x_m), 1)} ${p.x_m < 0 ? "behind" : "ahead"}`;
  const left = `${formatMetres(Math.abs(p.y_m), 1)} ${p.y_m < 0 ? "right" : "left"}`;
  /** @type {Record<Hit["kind"], () => Array<[string, any]|false>>} */
  const facts = {
    intersection: () => [
      ["Uncertainty (1 σ)", formatMetres(p.position_std_m)],
      ["Confidence", formatPercent(p.confidence)],
      ["Detections", String(p.observations)],
      ["Seen in scans", `${p.first_frame} to ${p.last_frame}`],
      branches(),
      p.uid && ["Name of the place", p.uid],
    ],
    node: () => [
      ["OSM node", osmLink(p.osm_id, result)],
      p.intersection !== undefined && p.intersection !== null && ["Intersection", String(p.intersection)],
      ["Roads that meet", String(p.degree)],
      ["In the relevant zone of", plural(p.keyframes_in_zone, "keyframe")],
      ["Not detected in", plural(p.keyframes_missed, "of these", "of these")],
      ["Detections", String(p.detections)],
      ["Median error", formatMetres(medianError(result, p))],
    ],
    detection: () => [
      ["Scan", String(p.frame)],
      item.outcome !== "TP" && item.error_m !== null && ["Error", formatMetres(item.error_m)],
      item.outcome !== "TP" && item.osm_id !== null && ["Matched to OSM node", osmLink(item.osm_id, result)],
      ["Score", p.score?.toFixed(2) ?? "–"],
      ["From the LiDAR", `${ahead}, ${left}`],
      branches(),
      ["Part of", p.intersection === null ? "no intersection of the map" : `intersection ${p.intersection}`],
    ],
    keyframe: () => [
      ["Scan", String(p.frame)],
      p.time_s !== null && ["Time", formatDuration(p.time_s)],
      ["Heading", `${Math.round(p.heading_deg)}°`],
      ["Detections", String(p.detections)],
    ],
  };
  return [...facts[kind](), [local ? "x, y in W, metres" : "Latitude, longitude", coordinates(item, local)]];
}

/** @param {number[]} values @param {boolean} local @returns {string} */
function bearings(values, local) {
  const names = ["N", "NE", "E", "SE", "S", "SW", "W", "NW"];
  return [...values]
    .sort((a, b) => a - b)
    .map((b) => `${Math.round(b)}°${local ? "" : ` ${names[Math.round(b / 45) % 8]}`}`)
    .join(", ");
}

/** @param {number|null|undefined} id @param {Result} result @returns {string|Node} */
function osmLink(id, result) {
  if (id === null || id === undefined) return "–";
  if (!isOsmNode(id, result)) return String(id);
  return el("a", { href: `https://www.openstreetmap.org/node/${id}`, target: "_blank", rel: "noopener" }, String(id));
}

/** @param {number|null|undefined} id @param {Result} result @returns {boolean} Whether openstreetmap.org may know it. */
export const isOsmNode = (id, { isMadeUp }) => typeof id === "number" && id > 0 && !isMadeUp;
