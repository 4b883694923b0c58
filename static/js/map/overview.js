/** All drives on the map, where none is chosen: a click opens one. */
import { lists } from "../data/lists.js";
import { loadRoads } from "../data/results.js";
import { el, plural } from "../dom.js";
import { showError } from "../messages.js";
import { setState } from "../state.js";
import { beginTexts, fill, nearestOn, project, stroke, strokePaths, writeText } from "./paths.js";
import { paintRoads, roadsOf } from "./roads.js";
import { paintSigns, SIGNS, trace } from "./symbols.js";

/** @import { DriveOnMap } from "../data/overview.js" */
/** @import { View } from "./surface.js" */
/**
 * @typedef {object} Item Places are those at zoom 0.
 * @property {DriveOnMap} drive
 * @property {Float64Array} path
 * @property {Float64Array} points
 * @property {[number, number]} middle
 * @property {[number, number, number, number]} box Of the path: left, top, right, bottom.
 * @property {string} label
 * @property {number} width Of the label, pixels; 0 until it is known.
 */

export const REACH_PX = 10;
const SMALL_PX = 16; // a track that is smaller is a disc
const SIGNS_FROM_ZOOM = 13;
const ROADS_FROM_ZOOM = 12;
const MAX_ROADS = 20; // drives whose roads are drawn
const NAME_PX = 16;

/** Painted as a scene is; see `Scene`. */
export class OverviewScene {
  /** @param {DriveOnMap[]} drives @param {any} map */
  constructor(drives, map) {
    this.map = map;
    this.items = this.itemsOf(drives);
    /** Its signs: x and y at zoom 0. @type {any[]} */
    this.spots = this.items.flatMap(({ points }) =>
      Array.from({ length: points.length / 2 }, (_, i) => ({ x: points[2 * i], y: points[2 * i + 1] })),
    );
    /** @type {Item|null} Under the pointer. */
    this.under = null;
    /** What scenes of results have, too. */
    this.result = { local: false };
    /** @type {Set<string>} */
    this.on = new Set();
    /** By the job that they were read for. @type {Map<string|null, import("./roads.js").Road[]>} */
    this.roads = new Map();
    this.progress = 0;
    this.hasTiles = false;
  }

  /** @param {DriveOnMap[]} drives @returns {Item[]} */
  itemsOf(drives) {
    return drives.map((drive) => {
      const path = this.project(drive.track);
      const half = 2 * Math.floor(path.length / 4);
      const label = drive.name.length > 28 ? `${drive.name.slice(0, 27)}…` : drive.name;
      const middle = /** @type {[number, number]} */ ([path[half], path[half + 1]]);
      return { drive, path, points: this.project(drive.intersections), middle, box: boxOf(path), label, width: 0 };
    });
  }

  /** @param {number[][]} places */
  project(places) {
    return project(this.map, places);
  }

  /** Fetch the roads of the maps that its drives were scored against, each once. @param {() => void} redraw */
  loadRoads(redraw) {
    const jobs = new Set(this.items.map(({ drive }) => drive.job));
    for (const id of this.roads.keys()) if (!jobs.has(id)) this.roads.delete(id);
    for (const job of lists.jobs) {
      if (!jobs.has(job.id) || !job.request.osm || this.roads.has(job.id) || this.roads.size >= MAX_ROADS) continue;
      this.roads.set(job.id, []);
      loadRoads(job).then((lines) => {
        if (!this.roads.has(job.id)) return;
        this.roads.set(job.id, roadsOf(this.map, lines));
        redraw();
      }, showError);
    }
  }

  /** What lies below the tracks. @param {CanvasRenderingContext2D} context @param {View} view */
  paintGround(context, view) {
    if (!this.on.has("roads") || view.zoom < ROADS_FROM_ZOOM) return;
    context.lineCap = "round";
    context.lineJoin = "round";
    paintRoads(
      context,
      view,
      [...this.roads.values()].flat().sort((a, b) => a.width - b.width),
    );
  }

  /** @param {CanvasRenderingContext2D} context @param {View} view */
  paint(context, view) {
    context.lineCap = "round";
    context.lineJoin = "round";
    const seen = this.items.filter((item) => isSeen(item, view));
    const discs = seen.filter((item) => isSmall(item, view));
    const lines = seen.filter((item) => !isSmall(item, view) && item !== this.under);
    const paths = lines.map(({ path }) => path);
    strokePaths(context, view, paths, "--accent", 2.5);
    if (this.under && !isSmall(this.under, view)) strokePaths(context, view, [this.under.path], "--accent", 5);
    context.beginPath();
    for (const { middle } of discs) trace(context, "disc", view.x(middle[0]), view.y(middle[1]), 6);
    fill(context, "--accent");
    stroke(context, "--surface", 2);
    if (view.zoom >= SIGNS_FROM_ZOOM) {
      for (const name of ["unscored", "not_counted", "right", "wrong"]) {
        const spots = seen.flatMap(({ points, drive }) =>
          [...drive.intersections.keys()]
            .filter((i) => (drive.outcomes[i] ?? "unscored") === name)
            .map((i) => [view.x(points[2 * i]), view.y(points[2 * i + 1])])
            .filter(([x, y]) => view.shows(x, y)),
        );
        paintSigns(context, SIGNS[name], spots, view.zoom > 15 ? 7.5 : 4.5);
      }
    }
    paintNames(context, view, seen, this.spots);
  }

  /** Where the map was moved to may be more to show. */
  look() {}

  /** @param {any} hit Found by `at`. @returns {HTMLElement} */
  tipOf({ item }) {
    const { name, job, title, chosen, intersections, verdict } = item.drive;
    const text = job ? (verdict ?? plural(intersections.length, "intersection")) : "no result yet";
    const which = job && ` ${title}${chosen === "pinned" ? ", pinned" : ""}`;
    return el("div", el("strong", name), which, el("br"), text);
  }

  /** @param {any} hit Found by `at`. */
  open({ item }) {
    const { id, job } = item.drive;
    setState({ drive: id, job, frame: null, view: null, panel: job ? "result" : "drives" });
  }

  /** @param {Item|null} item Under the pointer: it is drawn above the others. */
  lift(item) {
    this.under = item;
    return true;
  }

  /** @param {View} view @param {number} x Pixels. @param {number} y @returns {any} The nearest drive. */
  at(view, x, y) {
    let nearest = null;
    let min = REACH_PX;
    for (const item of this.items) {
      if (!isSeen(item, view)) continue;
      const [dx, dy] = [view.x(item.middle[0]) - x, view.y(item.middle[1]) - y];
      const away = isSmall(item, view) ? Math.hypot(dx, dy) : nearestOn(item.path, view, x, y).away;
      if (away < min) [nearest, min] = [item, away];
    }
    return nearest && { kind: "drive", item: nearest };
  }
}

/** As many names as have room beside signs. @param {CanvasRenderingContext2D} context @param {View} view @param {Item[]} items @param {{x: number, y: number}[]} signs At zoom 0. */
function paintNames(context, view, items, signs) {
  beginTexts(context, "bottom", "--ink");
  /** @type {Map<number, [number, number, number][]>} Left, bottom, width; by rows of the map. */
  const taken = new Map();
  for (const { x, y } of signs) {
    const bottom = view.y(y) + NAME_PX / 2;
    const row = Math.floor(bottom / NAME_PX);
    taken.set(row, [...(taken.get(row) ?? []), [view.x(x) - NAME_PX / 2, bottom, NAME_PX]]);
  }
  for (const item of items) {
    const x = view.x(item.middle[0]);
    const top = view.y(item.middle[1]) - 9;
    if (!view.shows(x, top)) continue;
    item.width ||= context.measureText(item.label).width;
    const left = x - item.width / 2;
    const isFree = (/** @type {number} */ y) => {
      const row = Math.floor(y / NAME_PX);
      const near = [row - 1, row, row + 1].flatMap((each) => taken.get(each) ?? []);
      return !near.some(([l, b, w]) => left < l + w + 4 && l < left + item.width + 4 && Math.abs(y - b) < NAME_PX);
    };
    const y = [top, top - NAME_PX, top + 2 * NAME_PX].find(isFree); // drives through one street have one middle
    if (y === undefined) continue;
    const row = Math.floor(y / NAME_PX);
    taken.set(row, [...(taken.get(row) ?? []), [left, y, item.width]]);
    writeText(context, item.label, x, y);
  }
}

/** @param {Float64Array} path @returns {[number, number, number, number]} */
function boxOf(path) {
  let [left, top, right, bottom] = [Infinity, Infinity, -Infinity, -Infinity];
  for (let i = 0; i < path.length; i += 2) {
    left = Math.min(left, path[i]);
    right = Math.max(right, path[i]);
    top = Math.min(top, path[i + 1]);
    bottom = Math.max(bottom, path[i + 1]);
  }
  return [left, top, right, bottom];
}

/** @param {Item} item @param {View} view @returns {boolean} Whether something of it may be on the canvas. */
function isSeen({ box: [left, top, right, bottom] }, view) {
  const { x: width, y: height } = view.size;
  return (
    view.x(right) > -SMALL_PX &&
    view.x(left) < width + SMALL_PX &&
    view.y(bottom) > -SMALL_PX &&
    view.y(top) < height + SMALL_PX
  );
}

/** @param {Item} item @param {View} view */
function isSmall({ box: [left, top, right, bottom] }, view) {
  return Math.max(right - left, bottom - top) * view.scale < 2 * SMALL_PX;
}
