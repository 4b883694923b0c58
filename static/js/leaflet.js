/** Leaflet, as installed by npm: the one place that knows where it lies. It has no types of its own. */
// @ts-expect-error
import * as Leaflet from "../node_modules/leaflet/dist/leaflet-src.esm.js";

/** @type {any} */
const all = Leaflet;

export const {
  Browser,
  CircleMarker,
  Control,
  control,
  CRS,
  DivIcon,
  DomEvent,
  DomUtil,
  ImageOverlay,
  latLngBounds,
  LayerGroup,
  Map: LeafletMap,
  Marker,
  Polygon,
  Polyline,
  Popup,
  Renderer,
  SVG,
  TileLayer,
  Tooltip,
} = all;
