/**
 * Tips under the pointer, and the details of what is clicked.
 * @module map/details
 */

import { el } from "../dom.js";
import { CircleMarker, Popup, SVG, Tooltip } from "../leaflet.js";
import { getState, setState } from "../state.js";
import { shown } from "./shown.js";
import { View } from "./surface.js";
import { factsOf, summaryOf, titleOf } from "./words.js";

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

  /** @param {any} event @returns {import("./scene.js").Hit|null} */
  const find = (event) => {
    const current = scene();
    if (!current) return null;
    const view = new View(map, map.getZoom(), map.getPixelBounds().min, map.getSize());
    return current.find(view, event.containerPoint.x, event.containerPoint.y);
  };
  /** @type {any} */
  let under = null;
  /** @param {import("./scene.js").Hit|null} hit */
  const show = (hit) => {
    if (hit?.item === under) return;
    under = hit?.item ?? null;
    map.getContainer().classList.toggle("over", Boolean(hit));
    if (!hit) {
      mark.remove();
      tip.remove();
      return;
    }
    mark.setLatLng([hit.item.lat, hit.item.lng]).addTo(map);
    tip
      .setLatLng([hit.item.lat, hit.item.lng])
      .setContent(el("div", {}, el("strong", {}, titleOf(hit)), el("br"), summaryOf(hit)));
    tip.addTo(map);
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
 * @param {import("./scene.js").Hit} hit
 * @param {boolean} local
 */
export function openDetails(map, hit, local) {
  const { item, kind } = hit;
  const frame = {
    detection: item.properties.frame,
    intersection: Math.round((item.properties.first_frame + item.properties.last_frame) / 2),
  }[/** @type {string} */ (kind)];
  const content = el(
    "div",
    { class: "details" },
    el("h3", {}, titleOf(hit)),
    el(
      "dl",
      { class: "figures" },
      factsOf(hit, local).map(([name, value]) => [el("dt", {}, name), el("dd", {}, value)]),
    ),
    frame !== undefined && el("button", { onClick: () => setState({ frame, drawer: true }) }, "Look at its keyframe"),
    kind === "node" &&
      el(
        "button",
        { onClick: () => setState({ panel: "report", node: item.properties.osm_id }) },
        "See it in the report",
      ),
  );
  if (kind === "detection" && getState().frame !== frame) setState({ frame });
  new Popup({ maxWidth: 320, minWidth: 240, maxHeight: Math.max(140, map.getSize().y - 110), autoPanPadding: [24, 24] })
    .setLatLng([item.lat, item.lng])
    .setContent(content)
    .openOn(map);
}

/**
 * Go to a thing and open its details.
 * @param {import("./scene.js").Hit} hit
 */
export function goTo(hit) {
  const { map, result } = shown;
  if (!map || !result) return;
  const zoom = Math.max(map.getZoom(), result.local ? 2.5 : 18.5);
  map.once("moveend", () => openDetails(map, hit, result.local)); // on the way there the box would not find its room
  map.setView([hit.item.lat, hit.item.lng], zoom, { animate: true });
}
