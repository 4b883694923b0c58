/** What is known of a thing on the map, in words: its verdict first. */
import { outLink } from "../controls.js";
import { medianError } from "../data/results.js";
import { el, formatDuration, formatMetres, formatPercent, plural } from "../dom.js";
import { ellipseOf, SIGMAS_95 } from "./ellipse.js";
import { kindOfNode, layerOfDetection, NODE_OUTCOMES, VERDICTS, verdictOf } from "./layers.js";
import { coordinates } from "./links.js";

/** @import { Result } from "../data/results.js" */
/** @import { Hit } from "./scene.js" */

const DETECTIONS = /** @type {Record<string, string>} */ ({
  none: "Detection",
  TP: "True detection",
  FP: "False detection",
});

/** @param {Hit} hit @returns {string|null} The name of its sign; null for keyframes. */
export function signOf({ kind, item }) {
  if (kind === "intersection") return verdictOf(item);
  if (kind === "node") return kindOfNode(item);
  return kind === "detection" ? layerOfDetection(item) : null;
}

/** @param {Hit} hit */
export function titleOf({ kind, item }) {
  if (kind === "intersection") {
    const verdict = verdictOf(item);
    return `Intersection ${item.properties.id}${verdict === "unscored" ? "" : `: ${VERDICTS[verdict]}`}`;
  }
  if (kind === "node") return `OSM intersection: ${NODE_OUTCOMES[kindOfNode(item)]}`;
  if (kind === "road") return `Road ${item.properties.id}, measured`;
  return kind === "detection" ? DETECTIONS[item.outcome] : `Keyframe at scan ${item.properties.frame}`;
}

/** @param {Hit} hit @returns {string} One line below the title. */
export function summaryOf({ kind, item }) {
  const { properties: p } = item;
  if (kind === "road") return `${widthText(p) ?? "width not known"} wide, ${formatMetres(p.length_m, 0)} long`;
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
  if (kind === "keyframe" || kind === "road") return null;
  if (kind === "node") {
    if (p.reason) return sentence(p.reason);
    return kindOfNode(item) === "outside" ? "In the relevant zone of no keyframe: it does not count." : null;
  }
  const { error_m, osm_id } = kind === "detection" ? item : p;
  const isRight = kind === "detection" ? item.outcome === "TP" : verdictOf(item) === "right";
  if (isRight) return el("span", `${formatMetres(error_m)} from OSM node `, osmLink(osm_id, result), ".");
  if (p.reason) return sentence(p.reason);
  if (item.outcome !== "FP") return null;
  return error_m === null ? "No OSM intersection in its region of interest." : null;
}

/** @param {any} properties @returns {string} Semi-axes of the ellipse, and where the longer one points. */
function ellipseText(properties) {
  const { major, minor, bearing } = ellipseOf(properties);
  const axes = `${(SIGMAS_95 * major).toFixed(1)} × ${formatMetres(SIGMAS_95 * minor, 1)}`;
  return minor > 0.95 * major ? axes : `${axes}, longest toward ${Math.round((bearing * 180) / Math.PI)}°`;
}

/** @param {any} road Properties of a measured one. @returns {string|null} Its width; at least so much where it was not driven. */
export const widthText = ({ width_m, is_driven }) =>
  width_m === null ? null : `${is_driven ? "" : "≥ "}${formatMetres(width_m, 1)}`;

/** @param {string} text */
const sentence = (text) => `${text[0].toUpperCase()}${text.slice(1)}.`;

/** All that is known of it, what matters most first. @param {Hit} hit @param {Result} result @returns {Array<[string, any]|false>} */
export function factsOf({ kind, item }, result) {
  const { local } = result;
  const { properties: p } = item;
  const ahead = `${formatMetres(Math.abs(p.x_m), 1)} ${p.x_m < 0 ? "behind" : "ahead"}`;
  const left = `${formatMetres(Math.abs(p.y_m), 1)} ${p.y_m < 0 ? "right" : "left"}`;
  /** @type {Record<Hit["kind"], () => Array<[string, any]|false>>} */
  const facts = {
    intersection: () => [
      ["Uncertainty (1 σ)", formatMetres(p.position_std_m)],
      ...branchesOf(p, local),
      p.position_cov_m2 && ["Semi-axes of 95 %", ellipseText(p)],
      ["Confidence", formatPercent(p.confidence)],
      ["Detections", String(p.observations)],
      ["Seen in scans", `${p.first_frame} to ${p.last_frame}`],
      p.uid && ["Identifier", p.uid],
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
      ...branchesOf(p, local),
      ["Part of", p.intersection === null ? "no intersection of the map" : `intersection ${p.intersection}`],
    ],
    road: () => [
      ["Width (median)", widthText(p) ?? "not known"],
      p.width_m !== null && ["Of 80 % of it", `${p.width_p10_m.toFixed(1)} to ${formatMetres(p.width_p90_m, 1)}`],
      ["Length", formatMetres(p.length_m, 0)],
      ["Driven", p.is_driven ? "yes" : "no: a side may have been hidden"],
      ["Seen as road", formatPercent(p.seen)],
      p.offset_std_m !== null && ["Uncertainty across (1 σ)", formatMetres(p.offset_std_m)],
      ["From, to", [p.start_kind, p.end_kind].map((end) => end.replaceAll("_", " ")).join(", ")],
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

/**
 * The bearings of the branches, ascending, and in the same order the widths of their roads, where any was measured.
 * @param {any} properties
 * @param {boolean} local
 * @returns {Array<[string, any]|false>}
 */
export function branchesOf({ branch_count, branch_bearings_deg, branch_widths_m = [] }, local) {
  const names = ["N", "NE", "E", "SE", "S", "SW", "W", "NW"];
  const branches = branch_bearings_deg
    .map((/** @type {number} */ bearing, /** @type {number} */ k) => ({ bearing, width: branch_widths_m[k] ?? null }))
    .sort((/** @type {any} */ a, /** @type {any} */ b) => a.bearing - b.bearing);
  const bearings = branches.map(
    (/** @type {any} */ { bearing: b }) => `${Math.round(b)}°${local ? "" : ` ${names[Math.round(b / 45) % 8]}`}`,
  );
  const widths = branches.map((/** @type {any} */ { width }) => (width === null ? "–" : formatMetres(width, 1)));
  const isMeasured = branches.some((/** @type {any} */ { width }) => width !== null);
  return [
    [`Branches (${branch_count})`, bearings.join(", ")],
    isMeasured && ["Widths of their roads", widths.join(", ")],
  ];
}

/** @param {string|null|undefined} id @param {Result} result @returns {string|Node} */
function osmLink(id, result) {
  if (id === null || id === undefined) return "–";
  if (!isOsmNode(id, result)) return id;
  return outLink(`https://www.openstreetmap.org/node/${id}`, id);
}

/** @param {string|null|undefined} id @param {Result} result @returns {boolean} Whether openstreetmap.org may know it. */
export const isOsmNode = (id, { isMadeUp }) => Number(id) > 0 && !isMadeUp;
