/** What stands in the corners of the map. */
import { el, icon } from "../dom.js";
import { Control, DomEvent } from "../leaflet.js";
import { coordinates } from "./facts.js";

/** Put an element into a corner; what is done in it is not done to the map. @param {any} map @param {string} position @param {HTMLElement} element */
export function addCorner(map, position, element) {
  const control = new Control({ position });
  control.onAdd = () => element;
  DomEvent.disableClickPropagation(element);
  DomEvent.disableScrollPropagation(element);
  control.addTo(map);
}

/** @param {any} map @returns {number} How much of it the open list of layers covers at the right, pixels. */
export function legendWidth(map) {
  const width = map.getContainer().querySelector(".legend:has(details[open])")?.offsetWidth ?? 0;
  return width < map.getSize().x / 2 ? width : 0;
}

/**
 * A button below those of the zoom.
 * @param {any} map
 * @param {string} symbol
 * @param {string} title Read aloud, and shown under the pointer.
 * @param {() => void} call
 * @returns {HTMLElement}
 */
export function addButton(map, symbol, title, call) {
  const onClick = (/** @type {Event} */ event) => (event.preventDefault(), call());
  const onKeydown = (/** @type {KeyboardEvent} */ event) => event.key === " " && onClick(event);
  const props = { href: "#", role: "button", title, "aria-label": title, onClick, onKeydown };
  const button = el("a", props, icon(symbol));
  addCorner(map, "topleft", el("div.leaflet-bar.leaflet-control", button));
  return button;
}

/** Say where the pointer is: latitude and longitude, or metres of W. @param {any} map @param {boolean} local */
export function addCoordinates(map, local) {
  const box = el("output.coordinates", { hidden: true, title: local ? "x, y in W, metres" : "Latitude, longitude" });
  addCorner(map, "bottomleft", box);
  map.on("mousemove", (/** @type {any} */ { latlng }) => {
    box.hidden = false;
    box.textContent = local ? `x, y  ${coordinates(latlng, true)} m` : coordinates(latlng, false);
  });
  map.on("mouseout", () => (box.hidden = true));
}
