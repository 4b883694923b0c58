/**
 * The chosen keyframe on the map: the vehicle, what it could see, what it detected.
 * @module map/keyframe
 */

import { svg } from "../dom.js";
import { CircleMarker, DivIcon, LayerGroup, Marker, Polygon, Polyline, SVG } from "../leaflet.js";

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
    const arrow = svg(
      "svg",
      { viewBox: "-14 -14 28 28", width: 28, height: 28, class: "vehicle" },
      svg("path", { d: "M0-11 8 9 0 5-8 9Z", transform: `rotate(${frame.heading(keyframe)})` }),
    );
    const sign = new DivIcon({ html: arrow, className: "vehicle-icon", iconSize: [28, 28] });
    this.vehicle.addLayer(
      new Marker([keyframe.lat, keyframe.lng], { icon: sign, interactive: false, keyboard: false, pane: "marks" }),
    );
  }
}
