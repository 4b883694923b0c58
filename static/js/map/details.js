/**
 * Tips under the pointer, and the details of what is clicked.
 * @module map/details
 */

/** @typedef {import("./scene.js").Hit} Hit */

import { factRows } from "../controls.js";
import { el, formatDuration, formatMetres, formatPercent, plural } from "../dom.js";
import { CircleMarker, Popup, SVG, Tooltip } from "../leaflet.js";
import { getState, setState } from "../state.js";
import { isWrong, kindOfNode } from "./layers.js";
import { shown } from "./shown.js";
import { View } from "./surface.js";

/**
 * Watch the pointer over the scene of a map.
 * @param {any} map
 * @param {() => import("./scene.js").Scene|null} scene
 */
export function watchPointer(map, scene) {
  const mark = new CircleMarker([0, 0], {
    radius: 10,
    className: "mark",
    fill: false,
    interactive: false,
    renderer: new SVG({ pane: "marks" }),
    pane: "marks",
  });
  const tip = new Tooltip({ direction: "top", offset: [0, -10], opacity: 1, className: "tip", interactive: false });

  /** @param {any} event @returns {Hit|null} */
  const find = (event) => {
    const current = scene();
    if (!current) return null;
    const view = new View(map, map.getZoom(), map.getPixelBounds().min, map.getSize());
    return current.find(view, event.containerPoint.x, event.containerPoint.y);
  };
  /** @type {any} */
  let under = null;
  /** @param {Hit|null} hit */
  const show = (hit) => {
    if (hit?.item === under) return;
    under = hit?.item ?? null;
    map.getContainer().classList.toggle("over", Boolean(hit));
    if (!hit) {
      mark.remove();
      tip.remove();
      return;
    }
    const at = [hit.item.lat, hit.item.lng];
    mark.setLatLng(at).addTo(map);
    const content = el("div", {}, el("strong", {}, titleOf(hit)), el("br"), summaryOf(hit));
    tip.setLatLng(at).setContent(content).addTo(map);
  };
  map.on("mousemove", (/** @type {any} */ event) =>
    show(map.dragging.moving() || overControl(event) ? null : find(event)),
  );
  map.on("mouseout dragstart zoomstart", () => show(null));
  map.on("click", (/** @type {any} */ event) => {
    const hit = find(event);
    if (!hit) return;
    show(null);
    if (hit.kind === "keyframe") setState({ frame: hit.item.properties.frame });
    else openDetails(map, hit, Boolean(scene()?.result.local));
  });
}

/** @param {any} event */
function overControl(event) {
  return event.originalEvent.target.closest?.(".leaflet-control, .leaflet-popup");
}

/**
 * Show all that is known of a thing.
 * @param {any} map
 * @param {Hit} hit
 * @param {boolean} local
 */
export function openDetails(map, hit, local) {
  const { item, kind } = hit;
  const frame = {
    detection: item.properties.frame,
    intersection: Math.round((item.properties.first_frame + item.properties.last_frame) / 2),
  }[/** @type {string} */ (kind)];
  const look = () => setState({ frame, drawer: true });
  const report = () => setState({ panel: "report", node: item.properties.osm_id });
  const content = el(
    "div",
    { class: "details" },
    el("h3", {}, titleOf(hit)),
    el("dl", { class: "figures" }, factRows(factsOf(hit, local))),
    frame !== undefined && el("button", { onClick: look }, "Look at its keyframe"),
    kind === "node" && el("button", { onClick: report }, "See it in the report"),
  );
  if (kind === "detection" && getState().frame !== frame) setState({ frame });
  new Popup({ maxWidth: 320, minWidth: 240, maxHeight: Math.max(140, map.getSize().y - 110), autoPanPadding: [24, 24] })
    .setLatLng([item.lat, item.lng])
    .setContent(content)
    .openOn(map);
}

/**
 * Go to a thing and open its details.
 * @param {Hit} hit
 */
export function goTo(hit) {
  const { map, result } = shown;
  if (!map || !result) return;
  const zoom = Math.max(map.getZoom(), result.local ? 2.5 : 18.5);
  map.once("moveend", () => openDetails(map, hit, result.local)); // while it moves the box would not find its room
  map.setView([hit.item.lat, hit.item.lng], zoom, { animate: true });
}

const NODES = { found: "found", missed: "missed", outside: "out of reach" };
const DETECTIONS = /** @type {Record<string, string>} */ ({
  none: "Detection",
  TP: "True detection",
  FP: "False detection",
});

/** @param {Hit} hit @returns {string} */
function titleOf({ kind, item }) {
  if (kind === "intersection") return `Intersection ${item.properties.id}${isWrong(item) ? ", wrong" : ""}`;
  if (kind === "node") return `OSM intersection, ${NODES[kindOfNode(item)]}`;
  return kind === "detection" ? DETECTIONS[item.outcome] : `Keyframe at scan ${item.properties.frame}`;
}

/** @param {Hit} hit @returns {string} One line below the title. */
function summaryOf({ kind, item }) {
  const { properties: p } = item;
  if (kind === "detection") {
    return `scan ${p.frame}${item.error_m === null ? "" : `, ${formatMetres(item.error_m)} from the OSM intersection`}`;
  }
  const detections = plural(p.observations ?? p.detections, "detection");
  if (kind === "intersection") {
    return `${detections}, ±${formatMetres(p.position_std_m)}, ${plural(p.branch_count, "branch", "branches")}`;
  }
  if (kind === "keyframe") return p.detections ? detections : "no detections";
  return p.detections
    ? `${detections}, ${formatMetres(p.median_error_m)} off (median)`
    : "no detection was matched to it";
}

/**
 * All that is known of it.
 * @param {Hit} hit
 * @param {boolean} local
 * @returns {Array<[string, any]|false>}
 */
function factsOf({ kind, item }, local) {
  const { properties: p } = item;
  const { lng, lat, error_m, osm_id } = item;
  /** @type {() => [string, any]} */
  const branches = () => [`Branches (${p.branch_count})`, bearings(p.branch_bearings_deg, local)];
  const ahead = `${formatMetres(Math.abs(p.x_m), 1)} ${p.x_m < 0 ? "behind" : "ahead"}`;
  const left = `${formatMetres(Math.abs(p.y_m), 1)} ${p.y_m < 0 ? "right" : "left"}`;
  /** @type {Record<Hit["kind"], () => Array<[string, any]|false>>} */
  const facts = {
    intersection: () => [
      p.outcome === "right" && [
        "Right",
        el("span", {}, `${formatMetres(p.error_m)} from OSM node `, osmLink(p.osm_id)),
      ],
      p.reason && ["Why wrong", p.reason],
      ["Detections", String(p.observations)],
      ["Uncertainty (1 σ)", formatMetres(p.position_std_m)],
      ["Confidence", formatPercent(p.confidence)],
      ["Seen in scans", `${p.first_frame} to ${p.last_frame}`],
      branches(),
    ],
    node: () => [
      ["OSM node", osmLink(p.osm_id)],
      p.reason && ["Why missed", p.reason],
      ["Roads that meet", String(p.degree)],
      ["In the relevant zone of", plural(p.keyframes_in_zone, "keyframe")],
      ["Not found in", plural(p.keyframes_missed, "of these", "of these")],
      ["Detections", String(p.detections)],
      ["Median error", formatMetres(p.median_error_m)],
    ],
    detection: () => [
      ["Scan", String(p.frame)],
      error_m !== null && ["Error", formatMetres(error_m)],
      osm_id !== null && ["Matched to OSM node", osmLink(osm_id)],
      item.outcome === "FP" && p.reason && ["Why false", p.reason],
      item.outcome === "FP" &&
        !p.reason &&
        error_m === null && ["Why false", "no OSM intersection in its region of interest"],
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
  const metres = `${lng.toFixed(2)} m, ${lat.toFixed(2)} m`;
  const degrees = `${lat.toFixed(7)}, ${lng.toFixed(7)}`;
  return [...facts[kind](), local ? ["x, y in W", metres] : ["Latitude, longitude", degrees]];
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
function osmLink(id) {
  if (id === null || id === undefined) return "–";
  if (id <= 0 || shown.result?.isMadeUp) return String(id);
  return el("a", { href: `https://www.openstreetmap.org/node/${id}`, target: "_blank", rel: "noopener" }, String(id));
}
