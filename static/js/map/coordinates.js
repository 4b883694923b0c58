/** Where the pointer is: latitude and longitude, or metres of W. */
import { el } from "../dom.js";
import { Control } from "../leaflet.js";
import { coordinates } from "./links.js";

/** @param {any} map @param {boolean} local */
export function addCoordinates(map, local) {
  const box = el("output.coordinates", {
    hidden: true,
    title: local ? "x, y in W, metres" : "Latitude, longitude",
  });
  const control = new Control({ position: "bottomleft" });
  control.onAdd = () => box;
  control.addTo(map);
  map.on("mousemove", (/** @type {any} */ { latlng }) => {
    box.hidden = false;
    box.textContent = local ? `x, y  ${coordinates(latlng, true)} m` : coordinates(latlng, false);
  });
  map.on("mouseout", () => (box.hidden = true));
}
