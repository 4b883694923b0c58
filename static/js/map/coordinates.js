/** Where the pointer is: latitude and longitude, or metres of W. */
import { el } from "../dom.js";
import { addCorner } from "./corners.js";
import { coordinates } from "./links.js";

/** @param {any} map @param {boolean} local */
export function addCoordinates(map, local) {
  const box = el("output.coordinates", {
    hidden: true,
    title: local ? "x, y in W, metres" : "Latitude, longitude",
  });
  addCorner(map, "bottomleft", box);
  map.on("mousemove", (/** @type {any} */ { latlng }) => {
    box.hidden = false;
    box.textContent = local ? `x, y  ${coordinates(latlng, true)} m` : coordinates(latlng, false);
  });
  map.on("mouseout", () => (box.hidden = true));
}
