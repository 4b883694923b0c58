/** The road seen by LiDAR as a picture below everything else: a base map that the drive made itself. */
import { getJson, loadPicture } from "../api.js";
import { ImageOverlay } from "../leaflet.js";
import { showError } from "../messages.js";

/**
 * @param {any} map
 * @returns {{show: (path: string|null) => void}} Shows the picture of a result, by its path on the server; null: none.
 */
export function roadSurface(map) {
  map.createPane("surface-of-road").style.zIndex = "220"; // above the tiles, below the roads of OpenStreetMap
  map.getPane("surface-of-road").style.pointerEvents = "none";
  /** @type {string|null} */
  let wanted = null;
  /** @type {any} */
  let overlay = null;

  /** @param {any} next */
  const replace = (next) => {
    overlay?.remove();
    overlay = next;
    overlay?.addTo(map);
    map.getContainer().classList.toggle("with-surface", Boolean(overlay));
  };
  /** @param {string} path */
  const load = async (path) => {
    /** @type {[{bounds_lonlat: number[]|null, bounds_world_m: number[]|null}, string]} */
    const [view, url] = await Promise.all([getJson(path), loadPicture(`${path}.png`)]);
    if (path !== wanted || overlay || !map.getPane("surface-of-road")) return;
    const [west, south, east, north] = /** @type {number[]} */ (view.bounds_lonlat ?? view.bounds_world_m);
    const corners = [
      [south, west],
      [north, east],
    ];
    replace(new ImageOverlay(url, corners, { pane: "surface-of-road", className: "road-surface" }));
  };
  return {
    show(path) {
      if (path === wanted) return;
      wanted = path;
      replace(null);
      if (path) load(path).catch(showError);
    },
  };
}
