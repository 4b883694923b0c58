/** The chosen keyframe on the map: the vehicle, what it could see, what it detected, and pictures of it. */

import { svg } from "../dom.js";
import { CircleMarker, DivIcon, ImageOverlay, LayerGroup, Marker, Polygon, Polyline, SVG } from "../leaflet.js";

const RAY_M = 18;

export class KeyframeLayer {
  /** @param {any} map */
  constructor(map) {
    this.map = map;
    this.renderer = new SVG({ pane: "keyframe" });
    this.area = new LayerGroup().addTo(map);
    this.vehicle = new LayerGroup().addTo(map);
  }

  /**
   * @param {import("../data/results.js").Result} result
   * @param {import("../data/results.js").Place|null} keyframe
   * @param {boolean} area Whether the region of interest is shown.
   */
  show(result, keyframe, area) {
    this.area.clearLayers();
    this.vehicle.clearLayers();
    if (!keyframe) return;
    const { frame } = result;
    const base = { interactive: false, renderer: this.renderer, pane: "keyframe" };
    if (area) {
      this.area.addLayer(new Polygon(frame.square(keyframe, result.roi_m), { ...base, className: "roi" }));
      if (result.zone_m && result.zone_m > 0)
        this.area.addLayer(new Polygon(frame.square(keyframe, result.zone_m), { ...base, className: "zone" }));
    }
    for (const detection of result.byFrame.get(keyframe.properties.frame) ?? []) {
      const at = /** @type {[number, number]} */ ([detection.lat, detection.lng]);
      const outcome = detection.outcome.toLowerCase();
      for (const bearing of detection.properties.branch_bearings_deg) {
        const angle = (bearing * Math.PI) / 180;
        const end = frame.offset(detection, RAY_M * Math.sin(angle), RAY_M * Math.cos(angle));
        this.vehicle.addLayer(new Polyline([at, end], { ...base, className: `ray ${outcome}` }));
      }
      this.vehicle.addLayer(new CircleMarker(at, { ...base, radius: 9, className: `seen ${outcome}` }));
    }
    const outline = svg("path", { d: "M0-11 8 9 0 5-8 9Z", transform: `rotate(${frame.heading(keyframe)})` });
    const arrow = svg("svg.vehicle", { viewBox: "-14 -14 28 28", width: 28, height: 28 }, outline);
    const icon = new DivIcon({ html: arrow, className: "vehicle-icon", iconSize: [28, 28] });
    const options = { icon, interactive: false, keyboard: false, pane: "marks" };
    this.vehicle.addLayer(new Marker([keyframe.lat, keyframe.lng], options));
  }
}

/** A picture laid on the map by its corners, turned as they are: top left, top right and bottom left, as lat, lng. */
export const TurnedImage = ImageOverlay.extend({
  options: { pane: "pictures", className: "turned-image" },

  /** @param {string} url @param {Array<[number, number]>} corners @param {any} options */
  initialize(url, corners, options) {
    ImageOverlay.prototype.initialize.call(this, url, corners, options);
    this._corners = corners;
    this.on("load", this._reset);
  },

  _reset() {
    this._transform((/** @type {any} */ corner) => this._map.latLngToLayerPoint(corner));
  },

  /** @param {any} event */
  _animateZoom(event) {
    this._transform((/** @type {any} */ corner) =>
      this._map._latLngToNewLayerPoint({ lat: corner[0], lng: corner[1] }, event.zoom, event.center),
    );
  },

  /** @param {(corner: [number, number]) => {x: number, y: number}} at */
  _transform(at) {
    const { naturalWidth: w, naturalHeight: h } = this._image;
    if (!w || !this._map) return;
    const [origin, right, down] = this._corners.map(at);
    const [a, b] = [(right.x - origin.x) / w, (right.y - origin.y) / w];
    const [c, d] = [(down.x - origin.x) / h, (down.y - origin.y) / h];
    this._image.style.imageRendering = Math.hypot(a, b) > 1 ? "pixelated" : "auto"; // cells stay cells
    this._image.style.transform = `matrix(${[a, b, c, d, origin.x, origin.y].join()})`;
  },
});
