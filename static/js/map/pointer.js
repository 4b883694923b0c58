/** The pointer over a map: its scene says what lies there, what a tip tells of it, and what a click on it does. */
import { CircleMarker, Tooltip } from "../leaflet.js";
import { View } from "./surface.js";

/**
 * @param {any} map
 * @param {() => any} scene What the map shows now; one that is there as a whole neither looks for more nor lifts anything.
 * @param {() => void} redraw
 */
export function watchPointer(map, scene, redraw) {
  const mark = ring("mark");
  const tip = new Tooltip({ direction: "top", offset: [0, -10], opacity: 1, className: "tip", interactive: false });
  const find = (/** @type {any} */ { containerPoint: { x, y } }) =>
    scene()?.at(new View(map, map.getPixelBounds().min, map.getSize()), x, y) ?? null;
  /** @type {any} */
  let under = null;
  /** @param {any} hit @param {any} [event] */
  const show = (hit, event) => {
    const current = scene();
    if ((hit?.item ?? null) === under) return;
    under = hit?.item ?? null;
    map.getContainer().classList.toggle("over", Boolean(hit));
    if (current?.lift?.(under)) redraw();
    mark.remove();
    if (!hit) return void tip.remove();
    const hasPlace = under.lat !== undefined; // a line is touched where the pointer is
    const at = hasPlace ? [under.lat, under.lng] : event.latlng;
    if (hasPlace) mark.setLatLng(at).addTo(map);
    tip.setLatLng(at).setContent(current.tipOf(hit)).addTo(map);
  };
  map.on("mousemove", (/** @type {any} */ event) =>
    show(map.dragging.moving() || isOverControl(event) ? null : find(event), event),
  );
  map.on("mouseout dragstart zoomstart", () => show(null));
  map.on("moveend", () => scene()?.look?.());
  map.on("click", (/** @type {any} */ event) => {
    const hit = find(event);
    if (!hit) return;
    show(null);
    scene().open(hit);
  });
}

const isOverControl = (/** @type {any} */ { originalEvent }) =>
  originalEvent.target.closest?.(".leaflet-control, .leaflet-popup");

/** @param {string} className */
export const ring = (className) =>
  new CircleMarker([0, 0], { radius: 11, className, fill: false, interactive: false, pane: "marks" });
