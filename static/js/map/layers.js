/**
 * The layers of a result: what they are called, what they hold, which are on.
 * @module map/layers
 */

/**
 * @typedef {object} LayerKind
 * @property {string} id In permalinks.
 * @property {string} title
 * @property {"Base"|"Drive"|"Found"|"Score"|"Keyframe"} group
 * @property {string|null} sign Of `SIGNS`; null for lines.
 * @property {string} [line] Class of its line in the legend.
 * @property {string} hint
 * @property {boolean} on By default.
 * @property {(result: import("../data/results.js").Result) => number|null} count null: no number is shown; 0 hides the layer.
 */

/** @type {LayerKind[]} */
export const LAYERS = [
  {
    id: "tiles",
    title: "Map tiles",
    group: "Base",
    sign: null,
    line: "tiles",
    hint: "Pictures from a tile server; needs the internet.",
    on: false,
    count: (r) => (r.local ? 0 : null),
  },
  {
    id: "roads",
    title: "OSM roads",
    group: "Base",
    sign: null,
    line: "road",
    hint: "Roads of the map that the drive was scored against.",
    on: true,
    count: (r) => r.roads.length,
  },
  {
    id: "track",
    title: "Trajectory",
    group: "Drive",
    sign: null,
    line: "track",
    hint: "Where the vehicle drove.",
    on: true,
    count: () => null,
  },
  {
    id: "keyframes",
    title: "Keyframes",
    group: "Drive",
    sign: "keyframe",
    hint: "Places at which the method looked for intersections.",
    on: false,
    count: (r) => r.keyframes.length,
  },
  {
    id: "intersections",
    title: "Intersections",
    group: "Found",
    sign: "fused",
    hint: "One for each place, from all its detections.",
    on: true,
    count: (r) => r.intersections.length,
  },
  {
    id: "uncertainty",
    title: "Uncertainty (2 σ)",
    group: "Found",
    sign: null,
    line: "uncertainty",
    hint: "The intersection lies in the circle with 86 % chance.",
    on: true,
    count: (r) => (r.intersections.length ? null : 0),
  },
  {
    id: "branches",
    title: "Branches",
    group: "Found",
    sign: null,
    line: "branch",
    hint: "Bearings of the roads that leave an intersection.",
    on: true,
    count: (r) => (r.intersections.length ? null : 0),
  },
  {
    id: "detections",
    title: "Detections",
    group: "Found",
    sign: "detection",
    hint: "One a keyframe that saw the intersection.",
    on: true,
    count: (r) => (r.report ? 0 : r.detections.length),
  },
  {
    id: "tp",
    title: "True detections",
    group: "Score",
    sign: "tp",
    hint: "An OSM intersection lies within D (TP).",
    on: true,
    count: (r) => (r.report ? r.detections.filter((d) => d.outcome === "TP").length : 0),
  },
  {
    id: "fp",
    title: "False detections",
    group: "Score",
    sign: "fp",
    hint: "No OSM intersection within D (FP).",
    on: true,
    count: (r) => (r.report ? r.detections.filter((d) => d.outcome === "FP").length : 0),
  },
  {
    id: "errors",
    title: "Error lines",
    group: "Score",
    sign: null,
    line: "error",
    hint: "From a detection to the OSM intersection it was matched to.",
    on: true,
    count: (r) => (r.matches.length ? null : 0),
  },
  {
    id: "found",
    title: "Found intersections",
    group: "Score",
    sign: "found",
    hint: "OSM intersections with a true detection.",
    on: true,
    count: (r) => r.nodes.filter((n) => kindOfNode(n) === "found").length,
  },
  {
    id: "missed",
    title: "Missed intersections",
    group: "Score",
    sign: "missed",
    hint: "OSM intersections that the drive passed without a true detection.",
    on: true,
    count: (r) => r.nodes.filter((n) => kindOfNode(n) === "missed").length,
  },
  {
    id: "outside",
    title: "Out of reach",
    group: "Score",
    sign: "outside",
    hint: "OSM intersections that no relevant zone held; they do not count.",
    on: false,
    count: (r) => r.nodes.filter((n) => kindOfNode(n) === "outside").length,
  },
  {
    id: "zone",
    title: "Seen area",
    group: "Keyframe",
    sign: null,
    line: "roi",
    hint: "Region of interest (S) and relevant zone of the chosen keyframe.",
    on: true,
    count: () => null,
  },
];

/** @param {import("../data/results.js").Place} node @returns {"found"|"missed"|"outside"} */
export function kindOfNode({ properties }) {
  if (properties.found) return "found";
  return properties.in_zone ? "missed" : "outside";
}

/** @param {string[]|null} chosen @returns {Set<string>} Ids of the layers that are on. */
export function layersOn(chosen) {
  return new Set(chosen ?? LAYERS.filter((each) => each.on).map((each) => each.id));
}
