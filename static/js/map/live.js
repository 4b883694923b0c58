/** A drive that is under way: what its session has said so far, and how it is drawn. */
import { trackAlone } from "../data/results.js";
import { plural } from "../dom.js";
import { fill, fillRings, project, stroke } from "./paths.js";
import { Scene } from "./scene.js";
import { trace } from "./symbols.js";

/** @import { View } from "./surface.js" */

const CANDIDATE_PX = 6;
const VEHICLE_PX = 9;
const MAX_PLACES = 20000; // of the track, as the server keeps them
const MAX_RINGS = 8000; // of road

/** What a session has said. */
export class LiveDrive {
  session = { name: "", georeferenced: true, keyframes: 0, dropped: 0 };
  /** @type {number[][]} */
  track = [];
  /** Polygons of road, each as rings: what came since the last picture. @type {number[][][][]} */
  roads = [];
  /** What was seen of the road before, projected. @type {Float64Array[]} */
  surface = [];
  /** By id. @type {Map<number, any>} */
  intersections = new Map();
  /** @type {{lng: number, lat: number, heading_deg: number}|null} */
  vehicle = null;
  /** Why it is over; null while it goes on. @type {string|null} */
  end = null;

  /** @param {any} said @returns {boolean} Whether nothing more is to come. */
  take(said) {
    if (said.type === "state") {
      const { session, track, roads, intersections, vehicle } = said;
      Object.assign(this, { session, track, roads: roads.flat(), surface: [] });
      this.intersections = new Map(intersections.map((/** @type {any} */ each) => [each.id, each]));
      this.#move(vehicle);
      if (session.state === "ended") this.end = "It has ended.";
    } else if (said.type === "scan") {
      this.session.dropped = said.dropped;
      if (said.is_keyframe) this.session.keyframes += 1;
      if (said.vehicle) {
        this.#move(said.vehicle);
        this.track.push([this.vehicle?.lng ?? 0, this.vehicle?.lat ?? 0]);
        this.track.splice(0, this.track.length - MAX_PLACES);
      }
      if (said.road) this.roads.push(...said.road);
      for (const event of said.events) {
        if (event.kind === "gone") this.intersections.delete(event.id);
        else this.intersections.set(event.id, event);
      }
    } else if (said.type === "dropped") {
      this.session.dropped = said.dropped;
    } else if (said.type === "end") {
      this.end = "It has ended.";
    } else if (said.type === "failed" || (said.type === "refused" && said.frame === null)) {
      this.end = `It was ended: ${said.reason}`;
    }
    return this.end !== null;
  }

  /** @returns {string} How far it is, in words. */
  get words() {
    const sure = [...this.intersections.values()].filter((each) => each.confirmed).length;
    const { keyframes, dropped } = this.session;
    const parts = [
      plural(keyframes, "keyframe"),
      `${plural(sure, "intersection")}, ${this.intersections.size - sure} unsure`,
    ];
    if (dropped) parts.push(`${plural(dropped, "scan")} dropped: it is too slow`);
    if (this.end) parts.push(this.end);
    return parts.join(" · ");
  }

  /** @param {any} vehicle */
  #move(vehicle) {
    if (vehicle) this.vehicle = { ...placeOf(vehicle), heading_deg: vehicle.heading_deg };
  }
}

/** @param {any} said Something with a place. @returns {{lng: number, lat: number}} */
const placeOf = ({ lon_deg, lat_deg, world_x_m, world_y_m }) => ({
  lng: lon_deg ?? world_x_m,
  lat: lat_deg ?? world_y_m,
});

/** The drive on the map: road, track, intersections that firm up, the vehicle. */
export class LiveScene extends Scene {
  /** @param {LiveDrive} drive @param {any} map */
  constructor(drive, map) {
    const places = [...drive.intersections.values()].map((properties) => ({ ...placeOf(properties), properties }));
    const result = trackAlone(drive.track, !drive.session.georeferenced);
    result.intersections = places.filter(({ properties }) => properties.confirmed);
    super(result, map);
    this.on = new Set(["track", "uncertainty", "branches", "unscored"]);
    /** @param {{lng: number, lat: number}} place */
    const at = ({ lng, lat }) => {
      const [x, y] = project(map, [[lng, lat]]);
      return { x, y };
    };
    this.candidates = places.filter(({ properties }) => !properties.confirmed).map(at);
    drive.surface.push(...drive.roads.splice(0).flatMap((rings) => rings.map((ring) => project(map, ring))));
    drive.surface.splice(0, drive.surface.length - MAX_RINGS);
    this.surface = drive.surface;
    this.vehicle = drive.vehicle && { ...at(drive.vehicle), heading_deg: drive.vehicle.heading_deg };
  }

  /** @returns {null} Nothing has details yet. */
  at() {
    return null;
  }

  /** @param {CanvasRenderingContext2D} context @param {View} view */
  paintGround(context, view) {
    fillRings(context, view, this.surface, "--seen-road");
  }

  /** @param {CanvasRenderingContext2D} context @param {View} view */
  paint(context, view) {
    super.paint(context, view);
    context.beginPath();
    for (const { x, y } of this.candidates) trace(context, "ring", view.x(x), view.y(y), CANDIDATE_PX);
    context.setLineDash([3, 2]);
    stroke(context, "--fused", 2);
    context.setLineDash([]);
    if (!this.vehicle) return;
    context.save();
    context.translate(view.x(this.vehicle.x), view.y(this.vehicle.y));
    context.rotate((this.vehicle.heading_deg * Math.PI) / 180);
    context.beginPath();
    trace(context, "vehicle", 0, 0, VEHICLE_PX);
    fill(context, "--accent");
    stroke(context, "--surface", 2);
    context.restore();
  }
}
