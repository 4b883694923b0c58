/**
 * The layers of a result: what they are called, what they hold, which are on.
 * @module map/layers
 */

/** @typedef {import("../data/results.js").Result} Result */
/** @typedef {"Base"|"Drive"|"Found"|"Score"|"Keyframe"} Group */

/**
 * @param {string} id In permalinks.
 * @param {Group} group
 * @param {string} title
 * @param {string} look In the legend: a sign of `SIGNS`, or "line" and the class of a line.
 * @param {string} hint
 */
const layer = (id, group, title, look, hint) => ({ id, group, title, look, hint });

export const LAYERS = [
  layer("tiles", "Base", "Map tiles", "line tiles", "Pictures from a tile server; needs the internet."),
  layer("surface", "Base", "Road seen by LiDAR", "line surface", "Where the drive's LiDAR saw road: a map of its own."),
  layer("roads", "Base", "OSM roads", "line road", "Roads of the map that the drive was scored against."),
  layer("track", "Drive", "Trajectory", "line track", "Where the vehicle drove."),
  layer("places", "Drive", "Next best places", "line place", "Where else the roads of the map fit the drive, worse."),
  layer("keyframes", "Drive", "Keyframes", "keyframe", "Places at which the method looked for intersections."),
  layer("intersections", "Found", "Intersections", "fused", "One for each place, from all its detections."),
  layer(
    "uncertainty",
    "Found",
    "Uncertainty (2 σ)",
    "line uncertainty",
    "It lies in the circle with a chance of 86 %.",
  ),
  layer("branches", "Found", "Branches", "line branch", "Bearings of the roads that leave an intersection."),
  layer("detections", "Found", "Detections", "detection", "One per keyframe that saw the intersection."),
  layer("tp", "Score", "True detections", "tp", "An OSM intersection lies within D (TP)."),
  layer("fp", "Score", "False detections", "fp", "No OSM intersection within D (FP)."),
  layer("errors", "Score", "Error lines", "line error", "From a detection to the OSM intersection it was matched to."),
  layer(
    "wrong",
    "Score",
    "Wrong intersections",
    "wrong",
    "Intersections without an OSM intersection of their own within 10 m.",
  ),
  layer("found", "Score", "Found intersections", "found", "OSM intersections with a true detection."),
  layer("missed", "Score", "Missed intersections", "missed", "OSM intersections passed without a true detection."),
  layer("outside", "Score", "Out of reach", "outside", "OSM intersections in no relevant zone; they do not count."),
  layer(
    "zone",
    "Keyframe",
    "Seen area",
    "line roi",
    "Region of interest (S) and relevant zone of the chosen keyframe.",
  ),
];

const OFF_BY_DEFAULT = new Set(["tiles", "keyframes", "outside"]);

/** How many things a layer holds; null: no number is shown; 0 hides the layer. */
const COUNTS = /** @type {Record<string, (result: Result) => number|null>} */ ({
  tiles: (r) => (r.local ? 0 : null),
  surface: (r) => (r.surface ? null : 0),
  roads: (r) => r.roads.length,
  places: (r) => r.places.length,
  keyframes: (r) => r.keyframes.length,
  intersections: (r) => r.intersections.filter((each) => !isWrong(each)).length,
  uncertainty: (r) => (r.intersections.length ? null : 0),
  branches: (r) => (r.intersections.length ? null : 0),
  detections: (r) => (r.report ? 0 : r.detections.length),
  tp: (r) => (r.report ? r.detections.filter((each) => each.outcome === "TP").length : 0),
  fp: (r) => (r.report ? r.detections.filter((each) => each.outcome === "FP").length : 0),
  errors: (r) => (r.matches.length ? null : 0),
  wrong: (r) => r.intersections.filter(isWrong).length,
  found: (r) => r.nodes.filter((each) => kindOfNode(each) === "found").length,
  missed: (r) => r.nodes.filter((each) => kindOfNode(each) === "missed").length,
  outside: (r) => r.nodes.filter((each) => kindOfNode(each) === "outside").length,
});

/** @param {Result} result @returns {{layer: typeof LAYERS[0], count: number|null}[]} Layers that hold something. */
export function layersOf(result) {
  const all = LAYERS.map((each) => ({ layer: each, count: COUNTS[each.id]?.(result) ?? null }));
  return all.filter(({ count }) => count !== 0);
}

/** @param {import("../data/results.js").Place} node @returns {"found"|"missed"|"outside"} */
export function kindOfNode({ properties }) {
  if (properties.found) return "found";
  return properties.in_zone ? "missed" : "outside";
}

/** @param {import("../data/results.js").Place} intersection @returns {boolean} By its score, where it has one. */
export const isWrong = ({ properties }) => properties.outcome === "wrong";

/** @param {string[]|null} chosen @returns {Set<string>} Ids of the layers that are on. */
export function layersOn(chosen) {
  return new Set(chosen ?? LAYERS.map((each) => each.id).filter((id) => !OFF_BY_DEFAULT.has(id)));
}
