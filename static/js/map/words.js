/**
 * What a thing on the map is, in words: for tips and details.
 * @module map/words
 */
import { el, formatDuration, formatMetres, formatPercent, plural } from "../dom.js";
import { kindOfNode } from "./layers.js";

/** @typedef {import("./scene.js").Hit} Hit */

/** @param {Hit} hit @returns {string} */
export function titleOf({ kind, item }) {
  const { properties: p } = item;
  if (kind === "intersection") return `Intersection ${p.id}`;
  if (kind === "node")
    return `OSM intersection, ${{ found: "found", missed: "missed", outside: "out of reach" }[kindOfNode(item)]}`;
  if (kind === "detection")
    return item.outcome === "none" ? "Detection" : item.outcome === "TP" ? "True detection" : "False detection";
  return `Keyframe at scan ${p.frame}`;
}

/** @param {Hit} hit @returns {string} One line below the title. */
export function summaryOf({ kind, item }) {
  const { properties: p } = item;
  if (kind === "intersection")
    return `${plural(p.observations, "detection")}, ±${formatMetres(p.position_std_m)}, ${plural(p.branch_count, "branch", "branches")}`;
  if (kind === "node")
    return p.detections
      ? `${plural(p.detections, "detection")}, ${formatMetres(p.median_error_m)} off (median)`
      : "no detection was matched to it";
  if (kind === "detection")
    return item.error_m === null
      ? `scan ${p.frame}`
      : `scan ${p.frame}, ${formatMetres(item.error_m)} from the OSM intersection`;
  return p.detections ? plural(p.detections, "detection") : "no detections";
}

/**
 * All that is known of it.
 * @param {Hit} hit
 * @param {boolean} local
 * @returns {Array<[string, string|Node]>}
 */
export function factsOf({ kind, item }, local) {
  const { properties: p } = item;
  /** @type {Array<[string, any]>} */
  const facts = [];
  if (kind === "intersection") {
    facts.push(["Detections", String(p.observations)]);
    facts.push(["Uncertainty (1 σ)", formatMetres(p.position_std_m)]);
    facts.push(["Confidence", formatPercent(p.confidence)]);
    facts.push(["Seen in scans", `${p.first_frame} to ${p.last_frame}`]);
    facts.push([`Branches (${p.branch_count})`, bearings(p.branch_bearings_deg, local)]);
  } else if (kind === "node") {
    facts.push(["OSM node", osmLink(p.osm_id)]);
    facts.push(["Roads that meet", String(p.degree)]);
    facts.push(["In the relevant zone of", plural(p.keyframes_in_zone, "keyframe")]);
    facts.push(["Not found in", plural(p.keyframes_missed, "of these", "of these")]);
    facts.push(["Detections", String(p.detections)]);
    facts.push(["Median error", formatMetres(p.median_error_m)]);
  } else if (kind === "detection") {
    facts.push(["Scan", String(p.frame)]);
    if (item.error_m !== null) facts.push(["Error", formatMetres(item.error_m)]);
    if (item.osm_id !== null) facts.push(["Matched to OSM node", osmLink(item.osm_id)]);
    if (item.outcome === "FP" && item.error_m === null)
      facts.push(["Why false", "no OSM intersection in its region of interest"]);
    facts.push(["Score", p.score?.toFixed(2) ?? "–"]);
    facts.push([
      "From the LiDAR",
      `${formatMetres(p.x_m, 1)} ${p.x_m < 0 ? "behind" : "ahead"}, ${formatMetres(Math.abs(p.y_m), 1)} ${p.y_m < 0 ? "right" : "left"}`.replace(
        "-",
        "",
      ),
    ]);
    facts.push([`Branches (${p.branch_count})`, bearings(p.branch_bearings_deg, local)]);
    facts.push(["Part of", p.intersection === null ? "no intersection of the map" : `intersection ${p.intersection}`]);
  } else {
    facts.push(["Scan", String(p.frame)]);
    if (p.time_s !== null) facts.push(["Time", formatDuration(p.time_s)]);
    facts.push(["Heading", `${Math.round(p.heading_deg)}°`]);
    facts.push(["Detections", String(p.detections)]);
  }
  facts.push(
    local
      ? ["x, y in W", `${item.lng.toFixed(2)} m, ${item.lat.toFixed(2)} m`]
      : ["Latitude, longitude", `${item.lat.toFixed(7)}, ${item.lng.toFixed(7)}`],
  );
  return facts;
}

/** @param {number[]} values @param {boolean} local @returns {string} */
function bearings(values, local) {
  const names = ["N", "NE", "E", "SE", "S", "SW", "W", "NW"];
  return [...values]
    .sort((a, b) => a - b)
    .map((b) => `${Math.round(b)}°${local ? "" : ` ${names[Math.round(b / 45) % 8]}`}`)
    .join(", ");
}

/** @param {number|null|undefined} id @returns {string|Node} */
export function osmLink(id) {
  if (id === null || id === undefined) return "–";
  if (id <= 0) return String(id);
  return el("a", { href: `https://www.openstreetmap.org/node/${id}`, target: "_blank", rel: "noopener" }, String(id));
}
