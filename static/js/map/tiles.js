/** Map tiles: only when switched on, since another server learns which place is looked at. */

import { getConfig } from "../api.js";
import { el } from "../dom.js";
import { TileLayer } from "../leaflet.js";
import { showError } from "../messages.js";

const OSM = "© OpenStreetMap contributors";
export const OSM_CREDIT = `${OSM}, ODbL`;

/** @returns {any} A layer of the tiles of the service. */
export function makeTiles() {
  const { tile_url: url, tile_attribution } = getConfig();
  if (!url) return null;
  const credit = tile_attribution || OSM;
  const layer = new TileLayer(url, {
    maxNativeZoom: 19,
    maxZoom: 24,
    attribution: credit.startsWith(OSM) ? OSM_CREDIT : el("span", credit).outerHTML, // alike, it is shown once
    referrerPolicy: "strict-origin-when-cross-origin",
    className: "tiles",
  });
  layer.once("tileerror", () => {
    const detail =
      `${new URL(url.replace("{s}", "a"), location.href).host} gave no tiles. Without the internet the roads of the OSM file are the ` +
      "base map; the operator can choose another tile server (INTERLOC_TILE_URL).";
    showError({ title: "Map tiles not loaded", detail });
  });
  return layer;
}
