/** Roads of OpenStreetMap as they are drawn: below all else. */
import { groupBy } from "../dom.js";
import { project, strokePaths } from "./paths.js";

/** @import { View } from "./surface.js" */
/** @typedef {{path: Float64Array, width: number, kind: string, isDrivable: boolean, name: string|null}} Road */

/** Classes of roads: metres as drawn, and the name of the colours; the widest are drawn last. */
const CLASSES = /** @type {Record<string, [number, string]>} */ ({
  motorway: [12, "major"],
  trunk: [11, "major"],
  primary: [9, "major"],
  secondary: [8.5, "main"],
  tertiary: [7.5, "main"],
  living_street: [5.5, "road"],
  service: [4, "service"],
});
const USUAL_CLASS = /** @type {[number, string]} */ ([6.5, "road"]);

/** @param {any} map @param {Array<{line: number[][], properties: any}>} lines @returns {Road[]} The widest last. */
export function roadsOf(map, lines) {
  const roads = lines.map(({ line, properties: { highway, is_drivable, name } }) => {
    const [width, kind] = CLASSES[String(highway).replace(/_link$/, "")] ?? USUAL_CLASS;
    return { path: project(map, line), width, kind, isDrivable: Boolean(is_drivable ?? true), name: name ?? null };
  });
  return roads.sort((a, b) => a.width - b.width);
}

/** @param {CanvasRenderingContext2D} context @param {View} view @param {Road[]} roads */
export function paintRoads(context, view, roads) {
  const width = (/** @type {number} */ metres) => Math.max(1.2, Math.min(metres * view.perMetre, 40));
  const driven = roads.filter((each) => each.isDrivable);
  const paths = roads.filter((each) => !each.isDrivable).map((each) => each.path);
  context.setLineDash(view.perMetre > 1 ? [5, 4] : []);
  strokePaths(context, view, paths, "--road-path", Math.min(2, width(1.5)));
  context.setLineDash([]);
  const groups = groupBy(driven, (each) => each.width);
  for (const [end, more] of Object.entries({ "-casing": 2, "": 0 })) {
    for (const group of groups.values()) {
      const [{ width: metres, kind }] = group;
      const own = group.map((each) => each.path);
      strokePaths(context, view, own, `--road-${kind}${end}`, width(metres) + more);
    }
  }
}
