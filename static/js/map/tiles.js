/** Map tiles: only when switched on, since another server learns which place is looked at. */

import { getConfig } from "../api.js";
import { el } from "../dom.js";
import { TileLayer } from "../leaflet.js";
import { showError } from "../messages.js";
import { news } from "../news.js";
import { keep, recall } from "../storage.js";

const URL_KEY = "interloc.tiles";
const OSM = "© OpenStreetMap contributors";
export const OSM_CREDIT = `${OSM}, ODbL`;
const changes = news();
/** Called when another address is to be used. */
export const onTilesChange = changes.hear;

function tileUrl() {
  return recall(URL_KEY) || getConfig().tile_url || "";
}

/** @returns {any} A layer of the tiles; null where there is no address. */
export function makeTiles() {
  const url = tileUrl();
  if (!url) return null;
  const credit = getConfig().tile_attribution || OSM;
  const layer = new TileLayer(url, {
    maxNativeZoom: 19,
    maxZoom: 24,
    attribution: credit.startsWith(OSM) ? OSM_CREDIT : el("span", credit).outerHTML, // alike, it is shown once
    referrerPolicy: "strict-origin-when-cross-origin",
    className: "tiles",
  });
  layer.once("tileerror", () => {
    const detail =
      `${hostOf(url)} gave no tiles. Without the internet the roads of the OSM file are the base map; ` +
      "another tile server must be allowed by the operator (INTERLOC_TILE_URL).";
    showError({ title: "Map tiles not loaded", detail });
  });
  return layer;
}

/** @param {string} url */
function hostOf(url) {
  try {
    return new URL(url.replace("{s}", "a")).host;
  } catch {
    return url;
  }
}

/** @returns {HTMLElement} The field for another address. */
export function tileBox() {
  const label = "Address of the tiles, with {z}/{x}/{y}";
  const input = el("input", { type: "url", value: tileUrl(), spellcheck: false, "aria-label": label });
  const onSubmit = (/** @type {Event} */ event) => {
    event.preventDefault();
    const url = input.value.trim();
    keep(URL_KEY, url && url !== getConfig().tile_url ? url : null);
    changes.tell();
  };
  return el("form.tile-box", { onSubmit }, input, el("button", "Use"));
}
