/** A result on the surface: positions projected once, painted layer by layer, found again under the pointer. */
import { ellipseOf, SIGMAS_95 } from "../data/frame.js";
import { setState } from "../state.js";
import { openDetails, tipOf } from "./details.js";
import { widthText } from "./facts.js";
import { passes } from "./filter.js";
import { kindOfNode, layerOfDetection, verdictOf } from "./layers.js";
import { fill, fillRings, nearestOn, project, stroke, strokePaths } from "./paths.js";
import { paintRoads, roadsOf } from "./roads.js";
import { paintStreetNames, takenBySign } from "./street_names.js";
import { paintSigns, SIGNS } from "./symbols.js";

/** @import { View } from "./surface.js" */
/**
 * @typedef {{kind: "intersection"|"node"|"detection"|"keyframe"|"road", item: any}} Hit
 * @typedef {{xs: Float64Array, ys: Float64Array, items: any[]}} Points Projected at zoom 0.
 */

const RAY_M = 14;
const VERDICT_PX = { unscored: 8, not_counted: 8, right: 8, wrong: 10 };
/** From so many pixels per metre on (zoom 18.5) a sign is a ring, in which the detections of a place are seen. */
const RING_FROM = 3;
const RING_PX = 13;

export class Scene {
  tipOf = tipOf;

  /** @param {import("../data/results.js").Result} result @param {any} map */
  constructor(result, map) {
    /** @param {number} x At zoom 0. @param {number} y @returns {{lat: number, lng: number}} */
    this.unproject = (x, y) => map.options.crs.pointToLatLng({ x, y }, 0);
    const flat = (/** @type {number[][]} */ line) => project(map, line);
    /** @param {any[]} items @returns {Points} */
    const points = (items) => {
      const path = flat(items.map(({ lng, lat }) => [lng, lat]));
      return { xs: path.filter((_, i) => i % 2 === 0), ys: path.filter((_, i) => i % 2), items };
    };
    this.result = result;
    this.keyframes = points(result.keyframes);
    this.detections = points(result.detections);
    this.intersections = points(result.intersections);
    this.nodes = points(result.nodes);
    this.track = flat(result.trajectory);
    this.places = result.places.map(flat);
    this.buildings = result.buildings.map(flat);
    this.errors = result.matches.map(({ line, outcome }) => ({ path: flat(line), layer: outcome.toLowerCase() }));
    this.roads = roadsOf(map, result.roads);
    this.measured = result.measured.map(({ line, properties }) => ({
      path: flat(line),
      width: properties.width_m ?? 0,
      name: widthText(properties),
      properties,
    }));
    this.mouths = result.mouths.map(flat);
    /** @type {Set<string>} */
    this.on = new Set();
    /** Share of the drive that a running job has processed. */
    this.progress = 0;
    /** Whether map tiles have come: they bring names of streets. */
    this.hasTiles = false;
  }

  /** What lies below the pictures of a keyframe. @param {CanvasRenderingContext2D} context @param {View} view */
  paintGround(context, view) {
    context.lineCap = context.lineJoin = "round";
    if (this.on.has("roads")) {
      fillRings(context, view, this.buildings, "--building");
      paintRoads(context, view, this.roads);
    }
    if (this.on.has("measured")) this.#paintMeasured(context, view);
  }

  /** All the rest. @param {CanvasRenderingContext2D} context @param {View} view */
  paint(context, view) {
    const size = Math.min(1.35, Math.max(0.6, (view.zoom - (this.result.local ? -4 : 12)) / 6));
    context.lineCap = context.lineJoin = "round";
    this.#paintNames(context, view);
    if (this.on.has("places")) strokePaths(context, view, this.places, "--track", 1.4, 0.4);
    if (this.on.has("track")) strokePaths(context, view, [this.track], "--track", 1.6, 0.85);
    const done = this.track.slice(0, 2 * Math.ceil((this.progress * this.track.length) / 2));
    if (this.progress > 0) strokePaths(context, view, [done], "--accent", 5);
    this.#paintPoints(context, view, this.keyframes, "keyframes", 2 * size, 0.8);
    if (this.on.has("errors")) {
      for (const layer of ["tp", "fp"]) {
        if (!this.on.has(layer)) continue;
        const taken = new Set();
        const own = this.errors.filter((each) => each.layer === layer && isFresh(each.path, view, taken));
        const paths = own.map(({ path }) => path);
        strokePaths(context, view, paths, SIGNS[layer].colour, 1, layer === "tp" ? 0.55 : 0.35);
      }
    }
    if (this.on.has("uncertainty")) this.#paintUncertainty(context, view);
    /** @param {"detections"|"tp"|"fp"} layer @param {number} r @param {number} alpha */
    const paintDetections = (layer, r, alpha) =>
      this.#paintPoints(context, view, this.detections, layer, r, alpha, (each) => layerOfDetection(each) === layer);
    paintDetections("detections", 3 * size, 0.7);
    paintDetections("tp", 3 * size, 0.7);
    if (view.perMetre < RING_FROM) paintDetections("fp", 3.2 * size, 1);
    for (const kind of ["outside", "found", "missed"]) {
      const r = (kind === "missed" ? 8 : 4.5) * size;
      this.#paintPoints(context, view, this.nodes, kind, r, 1, (each) => kindOfNode(each) === kind);
    }
    if (this.on.has("branches")) this.#paintBranches(context, view);
    for (const verdict of /** @type {const} */ (["unscored", "not_counted", "right", "wrong"])) {
      const r = VERDICT_PX[verdict] * Math.max(0.85, size);
      const isOne = (/** @type {any} */ each) => verdictOf(each) === verdict && passes(each);
      this.#paintPoints(context, view, this.intersections, verdict, r, 1, isOne);
    }
    if (view.perMetre >= RING_FROM) paintDetections("fp", 3.2 * size, 1); // within the ring of what they are a part of
  }

  /** Of streets, and the widths of measured roads: none on another, none below a sign. @param {CanvasRenderingContext2D} context @param {View} view */
  #paintNames(context, view) {
    /** @type {import("./street_names.js").Taken[]} */
    const taken = [];
    for (const { xs, ys, items } of [this.intersections, this.nodes]) {
      items.forEach((item, i) => {
        const [x, y] = [view.x(xs[i]), view.y(ys[i])];
        const isOn = this.on.has(items === this.nodes.items ? kindOfNode(item) : verdictOf(item));
        if (isOn && view.shows(x, y)) taken.push(takenBySign(x, y));
      });
    }
    if (this.on.has("roads") && !this.hasTiles) paintStreetNames(context, view, this.roads, taken); // tiles have their own
    const widths = this.measured.map((each) => ({ ...each, width: 0 })); // the text stands beside the line
    if (this.on.has("measured")) paintStreetNames(context, view, widths, taken);
  }

  /** As wide as they were measured, on the picture of what was seen. @param {CanvasRenderingContext2D} context @param {View} view */
  #paintMeasured(context, view) {
    for (const [variable, more] of Object.entries({ "--measured": 2.5, "--measured-inside": 0 })) {
      for (const { path, width } of this.measured)
        if (width) strokePaths(context, view, [path], variable, Math.max(2, width * view.perMetre) + more);
      fillRings(context, view, this.mouths, variable, more);
    }
    const lines = this.measured.map((each) => each.path);
    strokePaths(context, view, lines, "--measured", view.perMetre > 2 ? 1.6 : 1);
  }

  /**
   * @param {CanvasRenderingContext2D} context
   * @param {View} view
   * @param {Points} points
   * @param {string} name Of the layer and its sign.
   * @param {number} r
   * @param {number} alpha
   * @param {(item: any) => boolean} [chosen]
   */
  #paintPoints(context, view, { xs, ys, items }, name, r, alpha, chosen) {
    if (!this.on.has(name)) return;
    const isRing = name in VERDICT_PX && view.perMetre >= RING_FROM;
    const sign = isRing
      ? { ...SIGNS[name], filled: false, width: 3, edge: undefined, glyph: undefined, rim: true }
      : SIGNS[name];
    if (isRing) r = RING_PX;
    const taken = new Set(); // pixels: a sign over a sign of the same kind changes nothing
    const drawn = [];
    for (let i = 0; i < items.length; i += 1) {
      if (chosen && !chosen(items[i])) continue;
      const x = view.x(xs[i]);
      const y = view.y(ys[i]);
      const pixel = Math.round(x) * 65536 + Math.round(y);
      if (!view.shows(x, y) || taken.has(pixel)) continue;
      taken.add(pixel);
      drawn.push([x, y]);
    }
    paintSigns(context, sign, drawn, r, alpha);
  }

  /** @param {CanvasRenderingContext2D} context @param {View} view */
  #paintUncertainty(context, view) {
    const { xs, ys, items } = this.intersections;
    for (const verdict of Object.keys(VERDICT_PX)) {
      context.beginPath();
      items.forEach((item, i) => {
        if (verdictOf(item) !== verdict) return;
        const { major, minor, bearing } = ellipseOf(item.properties);
        const r = SIGMAS_95 * major * view.perMetre;
        const [x, y] = [view.x(xs[i]), view.y(ys[i])];
        if (r <= 2 || !view.shows(x, y, r) || !passes(item)) return;
        const turn = bearing - Math.PI / 2; // of the canvas: clockwise from east
        context.moveTo(x + r * Math.cos(turn), y + r * Math.sin(turn));
        context.ellipse(x, y, r, SIGMAS_95 * minor * view.perMetre, turn, 0, 2 * Math.PI);
      });
      context.globalAlpha = 0.22;
      fill(context, SIGNS[verdict].colour);
      context.globalAlpha = 0.9;
      stroke(context, SIGNS[verdict].colour, 0.8);
      context.globalAlpha = 1;
    }
  }

  /** @param {CanvasRenderingContext2D} context @param {View} view */
  #paintBranches(context, view) {
    const reach = Math.min(60, Math.max(16, RAY_M * view.perMetre));
    if (RAY_M * view.perMetre < 6) return;
    const { xs, ys, items } = this.intersections;
    const from = view.perMetre >= RING_FROM ? RING_PX : 9;
    for (const verdict of Object.keys(VERDICT_PX)) {
      context.beginPath();
      items.forEach((item, i) => {
        const [x, y] = [view.x(xs[i]), view.y(ys[i])];
        if (verdictOf(item) !== verdict || !view.shows(x, y, reach) || !passes(item)) return;
        for (const bearing of item.properties.branch_bearings_deg) {
          const angle = (bearing * Math.PI) / 180;
          context.moveTo(x + from * Math.sin(angle), y - from * Math.cos(angle));
          context.lineTo(x + reach * Math.sin(angle), y - reach * Math.cos(angle));
        }
      });
      stroke(context, "--surface", 4.5);
      stroke(context, SIGNS[verdict].colour, 2);
    }
  }

  /**
   * What lies under the pointer: the nearest thing of the topmost layer.
   * @param {View} view Of which x and y are pixels.
   * @param {number} x
   * @param {number} y
   */
  at(view, x, y) {
    /** @type {Array<[Hit["kind"], Points, number, (item: any) => boolean]>} */
    const stack = [
      ["intersection", this.intersections, 9, (item) => this.on.has(verdictOf(item)) && passes(item)],
      ["node", this.nodes, 10, (item) => this.on.has(kindOfNode(item))],
      ["detection", this.detections, 7, (item) => this.on.has(layerOfDetection(item))],
      ["keyframe", this.keyframes, 7, () => this.on.has("track") || this.on.has("keyframes")],
    ];
    for (const [kind, points, reach, chosen] of stack) {
      const row = nearest(points, view, x, y, reach, chosen);
      if (row >= 0) return { kind, item: points.items[row] };
    }
    return this.on.has("measured") ? this.#findRoad(view, x, y) : null;
  }

  /** @param {Hit} hit */
  open(hit) {
    if (hit.kind === "keyframe") setState({ frame: hit.item.properties.frame });
    else openDetails(hit);
  }

  /** @param {View} view @param {number} x @param {number} y @returns {Hit|null} The measured road there. */
  #findRoad(view, x, y) {
    for (const { path, width, properties } of this.measured) {
      const { away, at } = nearestOn(path, view, x, y);
      if (away > Math.max(6, (width * view.perMetre) / 2)) continue;
      return { kind: "road", item: { ...this.unproject(at[0], at[1]), properties } };
    }
    return null;
  }
}

/** @param {Points} points @param {View} view @param {number} x @param {number} y @param {number} reach @param {(item: any) => boolean} chosen */
function nearest({ xs, ys, items }, view, x, y, reach, chosen) {
  let row = -1;
  let min = reach * reach;
  for (let i = 0; i < items.length; i += 1) {
    const d = (view.x(xs[i]) - x) ** 2 + (view.y(ys[i]) - y) ** 2;
    if (d < min && chosen(items[i])) [row, min] = [i, d];
  }
  return row;
}

/** @param {Float64Array} line Of two points. @param {View} view @param {Set<string>} taken @returns {boolean} Whether it is seen, and differs from the lines before by a pixel. */
function isFresh(line, view, taken) {
  const [x, y, toX, toY] = [view.x(line[0]), view.y(line[1]), view.x(line[2]), view.y(line[3])];
  if (!view.shows(x, y) && !view.shows(toX, toY)) return false;
  const key = `${Math.round(x)} ${Math.round(y)} ${Math.round(toX)} ${Math.round(toY)}`;
  if (taken.has(key)) return false;
  taken.add(key);
  return true;
}
