/** The layers of a result: what they are called, what they hold, which are on. */
import { getConfig } from "../api.js";

/** @import { Result } from "../data/results.js" */
/** @typedef {"Base"|"Drive"|"Intersections"|"OSM intersections"|"Detections"|"Keyframe"} Group */

/**
 * @param {string} id In permalinks; the name of its sign, too.
 * @param {Group} group
 * @param {string} title
 * @param {string} hint
 */
const layer = (id, group, title, hint) => ({ id, group, title, hint });

export const LAYERS = [
  layer("tiles", "Base", "Map tiles", "Pictures from a tile server; needs the internet."),
  layer("surface", "Base", "Road seen by LiDAR", "Where the drive's LiDAR saw road: a map of its own."),
  layer("roads", "Base", "OSM roads", "Roads of the map that the drive was scored against."),
  layer("measured", "Base", "Roads seen", "Centrelines and widths of the roads that the drive saw."),
  layer("track", "Drive", "Trajectory", "Where the vehicle drove."),
  layer("places", "Drive", "Next best places", "Where else the roads of the map fit the drive, worse."),
  layer("keyframes", "Drive", "Keyframes", "Places at which the method looked for intersections."),
  layer("right", "Intersections", "Right", "An OSM intersection of its own lies within 10 m."),
  layer("wrong", "Intersections", "Wrong", "No OSM intersection of its own lies within 10 m."),
  layer("not_counted", "Intersections", "Not counted", "At a junction of the map that the policy leaves out."),
  layer("unscored", "Intersections", "Not scored", "Found, but not compared with OpenStreetMap."),
  layer("uncertainty", "Intersections", "Uncertainty (95 %)", "It lies in the ellipse with a chance of 95 %."),
  layer("branches", "Intersections", "Branches", "Bearings of the roads that leave an intersection."),
  layer("found", "OSM intersections", "Found", "An intersection of the map is assigned to it, within 10 m."),
  layer("missed", "OSM intersections", "Missed", "Passed, and no intersection of the map is assigned to it."),
  layer("outside", "OSM intersections", "Out of reach", "In no relevant zone; they do not count."),
  layer("detections", "Detections", "Not scored", "Detections not compared with OpenStreetMap."),
  layer("tp", "Detections", "True", "An OSM intersection lies within D (TP)."),
  layer("fp", "Detections", "False", "No OSM intersection within D (FP)."),
  layer("errors", "Detections", "Error lines", "From a detection to the OSM intersection it is matched to."),
  layer(
    "zone",
    "Keyframe",
    "Seen area, zone in it",
    "Dashed: what the chosen keyframe sees (S). Solid: the relevant zone, in which intersections count.",
  ),
];

/** What an intersection, and what a node of the map, can be: what is worth a look comes first. */
export const VERDICTS = {
  wrong: "wrong",
  not_counted: "not counted by this policy",
  unscored: "not scored",
  right: "right",
};
export const NODE_OUTCOMES = { missed: "missed", found: "found", outside: "out of reach" };

/** Titles where nothing is scored: then these are all. */
const UNSCORED = /** @type {Record<string, string>} */ ({ unscored: "Intersections", detections: "Detections" });

const OFF_BY_DEFAULT = new Set(["tiles", "measured", "keyframes", "outside"]);

/** @typedef {(result: Result) => number|null} Count */

/**
 * Counts of kinds of things, by the ids of their layers.
 * @param {string[]} kinds
 * @param {(result: Result) => any[]} itemsOf
 * @param {(item: any) => string} kindOf
 * @returns {Record<string, Count>}
 */
const countsOf = (kinds, itemsOf, kindOf) =>
  Object.fromEntries(
    kinds.map((kind) => [kind, (result) => itemsOf(result).filter((each) => kindOf(each) === kind).length]),
  );

/** How many things a layer holds; null: no number is shown; 0 hides the layer. @type {Record<string, Count>} */
const COUNTS = {
  tiles: (r) => (r.local || !getConfig().tile_url ? 0 : null),
  surface: (r) => (r.surface ? null : 0),
  roads: (r) => r.roads.length,
  measured: (r) => r.measured.length,
  places: (r) => r.places.length,
  keyframes: (r) => r.keyframes.length,
  uncertainty: (r) => (r.intersections.length ? null : 0),
  branches: (r) => (r.intersections.length ? null : 0),
  errors: (r) => (r.matches.length ? null : 0),
  ...countsOf(Object.keys(VERDICTS), (r) => r.intersections, verdictOf),
  ...countsOf(Object.keys(NODE_OUTCOMES), (r) => r.nodes, kindOfNode),
  ...countsOf(["detections", "tp", "fp"], (r) => r.detections, layerOfDetection),
};

/** @param {Result} result @returns {{layer: typeof LAYERS[0], count: number|null}[]} Layers that hold something. */
export function layersOf(result) {
  const all = LAYERS.map((each) => {
    const title = result.report ? each.title : (UNSCORED[each.id] ?? each.title);
    return { layer: { ...each, title }, count: COUNTS[each.id]?.(result) ?? null };
  });
  return all.filter(({ count }) => count !== 0);
}

/**
 * What became of an OSM intersection, by the intersections of the map; by the detections where the result is of a
 * version that knew no better.
 * @param {{properties: any}} node
 * @returns {"found"|"missed"|"outside"}
 */
export function kindOfNode({ properties }) {
  if (properties.outcome) return properties.outcome;
  if (properties.found) return "found";
  return properties.in_zone ? "missed" : "outside";
}

/** @param {{properties: any}} intersection @returns {keyof typeof VERDICTS} */
export function verdictOf({ properties }) {
  return properties.outcome ?? "unscored";
}

const DETECTION_LAYERS = /** @type {const} */ ({ TP: "tp", FP: "fp", none: "detections" });

/** @param {{outcome: "TP"|"FP"|"none"}} detection */
export function layerOfDetection({ outcome }) {
  return DETECTION_LAYERS[outcome];
}

/** @param {string[]|null} chosen @returns {Set<string>} Ids of the layers that are on. */
export function layersOn(chosen) {
  return new Set(chosen ?? LAYERS.map((each) => each.id).filter((id) => !OFF_BY_DEFAULT.has(id)));
}
