/**
 * Leaflet, as installed by npm: the one place that knows where it lies.
 * @module leaflet
 */
// @ts-ignore - it has no types of its own
export * from "../node_modules/leaflet/dist/leaflet-src.esm.js";
