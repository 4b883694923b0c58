/**
 * What the server told the page about itself (`/config.json`).
 * @module shell/config
 */

/** @type {import("../api.js").PageConfig} */
let config = { version: "", tile_url: null, tile_attribution: "", overpass: false, needs_token: false, limits: {} };

/** @param {import("../api.js").PageConfig} loaded */
export function setConfig(loaded) {
  config = loaded;
}

/** @returns {import("../api.js").PageConfig} */
export function getConfig() {
  return config;
}
