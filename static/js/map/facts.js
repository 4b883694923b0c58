/** What is known of a thing on the map, in words: its verdict first. */
import { outLink } from "../controls.js";
import { el, formatMetres, plural } from "../dom.js";
import { kindOfNode, layerOfDetection, NODE_OUTCOMES, VERDICTS, verdictOf } from "./layers.js";

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

/** @param {any} road Properties of a measured one. @returns {string|null} Its width; at least so much where it was not driven. */
export const widthText = ({ width_m, is_driven }) =>
  width_m === null ? null : `${is_driven ? "" : "≥ "}${formatMetres(width_m, 1)}`;

/** @param {string} text */
const sentence = (text) => `${text[0].toUpperCase()}${text.slice(1)}.`;

/** What matters of it beside its verdict; files and lists have the rest. @param {Hit} hit @param {Result} result @returns {Parameters<typeof import("../controls.js").factList>[1]} */
export function factsOf({ kind, item }, result) {
  const { properties: p } = item;
  if (kind === "intersection")
    return [["Uncertainty (1 σ)", formatMetres(p.position_std_m)], ...branchesOf(p, result.local)];
  if (kind === "node")
    return [
      ["OSM node", osmLink(p.osm_id, result)],
      ["Roads that meet", String(p.degree)],
    ];
  if (kind === "detection")
    return [
      item.outcome !== "TP" && item.error_m !== null && ["Error", formatMetres(item.error_m)],
      ["Score", p.score?.toFixed(2) ?? "–"],
      ...branchesOf(p, result.local),
    ];
  if (kind === "road")
    return [
      ["Width (median)", widthText(p) ?? "not known"],
      ["Length", formatMetres(p.length_m, 0)],
      ["Driven", p.is_driven ? "yes" : "no: a side may have been hidden"],
    ];
  return [];
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

/** Where a place is looked at and edited; the page only links: nothing is loaded from there. @param {{lat: number, lng: number}} place @param {string|null} [node] Of OpenStreetMap, to be selected. */
export function waysOut({ lat, lng }, node = null) {
  const [y, x] = [lat.toFixed(7), lng.toFixed(7)];
  const osm = "https://www.openstreetmap.org";
  const edit = `${osm}/edit?editor=id${node ? `&node=${node}` : ""}#map=19/${y}/${x}`;
  return [
    outLink(`${osm}/?mlat=${y}&mlon=${x}#map=19/${y}/${x}`, "OpenStreetMap", {
      title: "This place on openstreetmap.org",
    }),
    outLink(edit, "iD", { title: "Edit this place in the browser, with the iD editor" }),
  ];
}

/** @param {{lat: number, lng: number}} place @param {boolean} local @returns {string} "49.0200010, 8.4200134" */
export function coordinates({ lat, lng }, local) {
  return local ? `${lng.toFixed(2)}, ${lat.toFixed(2)}` : `${lat.toFixed(7)}, ${lng.toFixed(7)}`;
}
