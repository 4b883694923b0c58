/**
 * All drives on the map, where none is chosen: a click opens one.
 * @module map/overview
 */
import { el, plural } from "../dom.js";
import { Tooltip } from "../leaflet.js";
import { setState } from "../state.js";
import { View } from "./surface.js";
import { colour, trace } from "./symbols.js";

/** @typedef {import("../data/overview.js").DriveOnMap} DriveOnMap */
/** @typedef {{drive: DriveOnMap, path: Float64Array, points: Float64Array, middle: [number, number]}} Item At zoom 0. */

const REACH_PX = 10;
const SMALL_PX = 16; // a track that is smaller is a disc
const SIGNS_FROM_ZOOM = 13;

/** Painted as a scene is; see `Scene`. */
export class OverviewScene {
  /** @param {DriveOnMap[]} drives @param {any} map */
  constructor(drives, map) {
    /** @param {number[][]} places */
    const flat = (places) => {
      const path = new Float64Array(2 * places.length);
      places.forEach(([lng, lat], i) => {
        const { x, y } = map.options.crs.latLngToPoint({ lat, lng }, 0);
        path[2 * i] = x;
        path[2 * i + 1] = y;
      });
      return path;
    };
    /** @type {Item[]} */
    this.items = drives.map((drive) => {
      const path = flat(drive.track);
      const half = 2 * Math.floor(path.length / 4);
      return { drive, path, points: flat(drive.intersections), middle: [path[half], path[half + 1]] };
    });
    this.map = map;
    /** @type {Item|null} Under the pointer. */
    this.under = null;
    /** What scenes of results have, too. */
    this.result = { local: false };
    /** @type {Set<string>} */
    this.on = new Set();
    this.progress = 0;
  }

  paintGround() {}

  /** @param {CanvasRenderingContext2D} context @param {View} view */
  paint(context, view) {
    context.lineCap = "round";
    context.lineJoin = "round";
    const discs = this.items.filter((item) => isSmall(item, view));
    const lines = this.items.filter((item) => !discs.includes(item) && item !== this.under);
    strokeAll(context, view, lines, colour("--accent"), 2.5);
    if (this.under && !discs.includes(this.under)) strokeAll(context, view, [this.under], colour("--accent"), 5);
    context.beginPath();
    for (const { middle } of discs) trace(context, "disc", view.x(middle[0]), view.y(middle[1]), 6);
    fillAndRim(context, colour("--accent"), colour("--surface"), 2);
    if (view.zoom >= SIGNS_FROM_ZOOM) {
      context.beginPath();
      for (const { points } of this.items) {
        for (let i = 0; i < points.length; i += 2) {
          const [x, y] = [view.x(points[i]), view.y(points[i + 1])];
          if (view.shows(x, y)) trace(context, "plus", x, y, view.zoom > 15 ? 6 : 4);
        }
      }
      fillAndRim(context, colour("--fused"), colour("--fused-edge"), 1);
    }
    this.#paintNames(context, view);
  }

  /** As many names as have room. @param {CanvasRenderingContext2D} context @param {View} view */
  #paintNames(context, view) {
    context.font = `600 12px ${getComputedStyle(document.body).fontFamily}`;
    context.textAlign = "center";
    context.textBaseline = "bottom";
    context.lineWidth = 3;
    context.strokeStyle = colour("--ground");
    context.fillStyle = colour("--ink");
    /** @type {[number, number, number][]} Left, bottom, width. */
    const taken = [];
    for (const { drive, middle } of this.items) {
      const [x, y] = [view.x(middle[0]), view.y(middle[1]) - 9];
      if (!view.shows(x, y)) continue;
      const text = drive.name.length > 28 ? `${drive.name.slice(0, 27)}…` : drive.name;
      const { width } = context.measureText(text);
      const left = x - width / 2;
      if (taken.some(([l, b, w]) => left < l + w + 4 && l < left + width + 4 && Math.abs(y - b) < 16)) continue;
      taken.push([left, y, width]);
      context.strokeText(text, x, y);
      context.fillText(text, x, y);
    }
  }

  /** Nothing with details: see `at`. @returns {null} */
  find() {
    return null;
  }

  /** @param {any} event Of the pointer. @returns {Item|null} The nearest drive. */
  at({ containerPoint: { x, y } }) {
    const { map } = this;
    const view = new View(map, map.getZoom(), map.getPixelBounds().min, map.getSize());
    let nearest = null;
    let min = REACH_PX;
    for (const item of this.items) {
      const [dx, dy] = [view.x(item.middle[0]) - x, view.y(item.middle[1]) - y];
      const away = isSmall(item, view) ? Math.hypot(dx, dy) : distance(item.path, view, x, y);
      if (away < min) [nearest, min] = [item, away];
    }
    return nearest;
  }
}

/**
 * Let the pointer choose among the drives.
 * @param {any} map
 * @param {() => any} scene What the map shows now.
 * @param {() => void} redraw
 */
export function watchDrives(map, scene, redraw) {
  const tip = new Tooltip({ direction: "top", offset: [0, -10], opacity: 1, className: "tip", interactive: false });
  /** @param {any} event */
  const find = (event) => {
    const current = scene();
    return current instanceof OverviewScene ? current.at(event) : null;
  };
  /** @type {any} */
  let last = null;
  /** @param {Item|null} item @param {any} [event] */
  const show = (item, event) => {
    const current = scene();
    if (current instanceof OverviewScene) map.getContainer().classList.toggle("over", Boolean(item));
    if (item === last) return;
    last = item;
    if (current instanceof OverviewScene) current.under = item;
    redraw();
    if (!item) return void tip.remove();
    const { name, job, intersections } = item.drive;
    const text = job ? plural(intersections.length, "intersection") : "no result yet";
    tip
      .setLatLng(event.latlng)
      .setContent(el("div", {}, el("strong", {}, name), el("br"), text))
      .addTo(map);
  };
  map.on("mousemove", (/** @type {any} */ event) => show(find(event), event));
  map.on("mouseout dragstart zoomstart", () => show(null));
  map.on("click", (/** @type {any} */ event) => {
    const item = find(event);
    if (!item) return;
    show(null);
    const { id, job } = item.drive;
    setState({ drive: id, job, frame: null, view: null, panel: job ? "job" : "drives" });
  });
}

/** @param {Item} item @param {View} view @returns {boolean} */
function isSmall({ path, middle }, view) {
  for (let i = 0; i < path.length; i += 2) {
    if (Math.max(Math.abs(path[i] - middle[0]), Math.abs(path[i + 1] - middle[1])) * view.scale > SMALL_PX)
      return false;
  }
  return true;
}

/** @param {Float64Array} path @param {View} view @param {number} x @param {number} y @returns {number} Pixels. */
function distance(path, view, x, y) {
  let min = Infinity;
  for (let i = 2; i < path.length; i += 2) {
    const [ax, ay] = [view.x(path[i - 2]), view.y(path[i - 1])];
    const [dx, dy] = [view.x(path[i]) - ax, view.y(path[i + 1]) - ay];
    const length = dx * dx + dy * dy;
    const t = length ? Math.max(0, Math.min(1, ((x - ax) * dx + (y - ay) * dy) / length)) : 0;
    min = Math.min(min, Math.hypot(ax + t * dx - x, ay + t * dy - y));
  }
  return min;
}

/** @param {CanvasRenderingContext2D} context @param {View} view @param {Item[]} items @param {string} stroke @param {number} width */
function strokeAll(context, view, items, stroke, width) {
  context.beginPath();
  for (const { path } of items) {
    for (let i = 0; i < path.length; i += 2) {
      const [x, y] = [view.x(path[i]), view.y(path[i + 1])];
      if (i) context.lineTo(x, y);
      else context.moveTo(x, y);
    }
  }
  context.strokeStyle = stroke;
  context.lineWidth = width;
  context.stroke();
}

/** @param {CanvasRenderingContext2D} context @param {string} inside @param {string} rim @param {number} width */
function fillAndRim(context, inside, rim, width) {
  context.fillStyle = inside;
  context.fill();
  context.strokeStyle = rim;
  context.lineWidth = width;
  context.stroke();
}
