/** Ways out to where a map is edited and looked at. The page only links: nothing is loaded from there. */
import { formatDate, formatMetres, plural } from "../dom.js";
import { verdictOf } from "./layers.js";

/** @import { Hit } from "./scene.js" */

const ZOOM = 19;
const HALF_M = 75; // of the square that an editor loads
const M_PER_DEG = 111320;

/** @param {number} lat @param {number} lng @param {number|null} [node] Of OpenStreetMap, to be selected. */
export function linksAt(lat, lng, node = null) {
  const [y, x] = [lat.toFixed(7), lng.toFixed(7)];
  const [dy, dx] = [HALF_M / M_PER_DEG, HALF_M / (M_PER_DEG * Math.cos((lat * Math.PI) / 180))];
  const box = { left: lng - dx, right: lng + dx, top: lat + dy, bottom: lat - dy };
  const query = Object.entries(box).map(([name, value]) => `${name}=${value.toFixed(7)}`);
  const at = `#map=${ZOOM}/${y}/${x}`;
  return [
    {
      name: "OpenStreetMap",
      href: `https://www.openstreetmap.org/?mlat=${y}&mlon=${x}${at}`,
      title: "This place on openstreetmap.org",
    },
    {
      name: "iD",
      href: `https://www.openstreetmap.org/edit?editor=id${node ? `&node=${node}` : ""}${at}`,
      title: "Edit this place in the browser, with the iD editor",
    },
    {
      // A link and no request of the page: its policy stays as strict as it is, and browsers ask nobody for leave.
      name: "JOSM",
      href: `http://127.0.0.1:8111/load_and_zoom?${query.join("&")}${node ? `&select=node${node}` : ""}`,
      title: "Load this place in JOSM on this machine: it must be running, with remote control switched on",
    },
    {
      name: "Mapillary",
      href: `https://www.mapillary.com/app/?lat=${y}&lng=${x}&z=17`,
      title: "Photos of the street at this place",
    },
  ];
}

/** @param {{lat: number, lng: number}} place @param {boolean} local @returns {string} "49.0200010, 8.4200134" */
export function coordinates({ lat, lng }, local) {
  return local ? `${lng.toFixed(2)}, ${lat.toFixed(2)}` : `${lat.toFixed(7)}, ${lng.toFixed(7)}`;
}

/**
 * What a note on openstreetmap.org may say of it.
 * @param {Hit} hit An intersection, a detection or a node.
 * @param {string|null} [mapDate] Of the map that the drive was scored against, ISO 8601.
 */
export function noteText({ kind, item }, mapDate = null) {
  const { properties: p } = item;
  const place = coordinates(item, false);
  const map = mapDate ? `OpenStreetMap of ${formatDate(mapDate)}` : "The map that was compared";
  if (kind === "node") {
    const seen = p.outcome === "found" ? "and a LiDAR drive found it" : "but a LiDAR drive did not find it";
    const why = p.reason ? `: ${p.reason}` : "";
    return `Node ${p.osm_id} (${place}) is a junction of ${plural(p.degree, "road")}, ${seen}${why}.`;
  }
  const day = (p.first_time ?? p.time) ? ` of ${formatDate(p.first_time ?? p.time)}` : "";
  const bearings = p.branch_bearings_deg.map((/** @type {number} */ b) => `${Math.round(b)}°`).join(", ");
  const count = kind === "detection" ? "once" : `in ${plural(p.observations, "scan")}`;
  const std = kind === "detection" ? "" : `, ±${formatMetres(p.position_std_m, 1).replace("\u00a0", " ")}`;
  const seen = `A LiDAR drive${day} saw a junction at ${place}${std}, ${count}; its roads leave at ${bearings}.`;
  const verdict = verdictOf(item);
  if (verdict === "unscored") return `${seen} It was not compared with OpenStreetMap.`;
  if (verdict === "not_counted") return `${seen} ${map} has it: ${p.reason}.`;
  const found =
    verdict === "right"
      ? `has it as node ${p.osm_id}, ${p.error_m.toFixed(1)} m away.`
      : `has no such junction there: ${p.reason ?? "no reason is known"}.`;
  return `${seen} ${map} ${found}`;
}
