/** The result of a job: its layers and report, loaded together. */
import { getJson } from "../api.js";
import { groupBy } from "../dom.js";
import { Frame } from "./frame.js";
import { FINAL } from "./lists.js";

/**
 * @typedef {{lng: number, lat: number, properties: any}} Place A point; metres of W in place of degrees without georeference.
 * @typedef {Place & {row: number, outcome: "TP"|"FP"|"none", error_m: number|null, osm_id: string|null}} Detection
 *   Outcome "none": there is no evaluation, or the map does not reach there.
 * @typedef {{osm_id: string|null, outcome: string, error_m: number, frame: number, detection: string|null, line: number[][]}} Match
 */

/**
 * @typedef {object} Result
 * @property {any} job
 * @property {any} run `run.json`
 * @property {any|null} report `report.json`; null without an evaluation.
 * @property {boolean} isMadeUp The map was made up by a simulator: its ids are not those of OpenStreetMap.
 * @property {boolean} local No georeference: positions are metres of W.
 * @property {Frame} frame Between metres and the map.
 * @property {Place[]} keyframes
 * @property {Detection[]} detections
 * @property {Map<number, Detection[]>} byFrame Detections of a scan number.
 * @property {Place[]} intersections
 * @property {number[][]} trajectory
 * @property {Place[]} nodes
 * @property {Match[]} matches
 * @property {Array<{line: number[][], properties: any}>} roads Of OpenStreetMap.
 * @property {Array<{line: number[][], properties: any}>} measured Roads as the drive saw them.
 * @property {number[][][]} mouths Outlines of the areas where these meet.
 * @property {number[][][]} buildings Outlines of those of the map near the track, and of their holes, the other way round.
 * @property {number[][][]} places Where else on the map the drive might have been, if it was placed by its roads.
 * @property {string|null} surface Path of the road seen by LiDAR; null where the result has none.
 * @property {number} roi_m Side S of the region of interest.
 * @property {number|null} zone_m Side S - 2 a_o of the relevant zone.
 */

const KEPT = 3;
/** By the ids of their jobs. @type {Map<string, Promise<{job: any, result: Result|null}>>} */
const cache = new Map();

/** Load a job and, once it is successful, its result; the last few that have ended are kept. @param {string} id */
export function loadResult(id) {
  const known = cache.get(id);
  if (known) return known;
  const asked = getJson(`jobs/${id}/view`).then((view) => ({ job: view.job, result: view.run && resultOf(view) }));
  cache.set(id, asked);
  const drop = () => cache.delete(id);
  asked.then(({ job }) => FINAL.has(job.state) || drop(), drop);
  const [oldest] = cache.keys();
  if (cache.size > KEPT) cache.delete(oldest);
  return asked;
}

/** @param {any} view Job, run, report and layers, as files have them; null for what the result lacks. @returns {Result} */
function resultOf({ job, run, report, ...layers }) {
  const local = !run.georeferenced;
  const keyframes = layers.keyframes.features.map(place);
  const matches = linesOf(layers.matches).map(({ line, properties }) => ({ ...properties, line }));
  const detections = detectionsOf(layers.detections.features, matches, report !== null);
  const config = run.config ?? {};
  const size = config.bev?.size_m ?? 120;
  return {
    job,
    run,
    report,
    isMadeUp: report?.osm?.made_up === true,
    local,
    frame: new Frame(keyframes, local),
    keyframes,
    detections,
    byFrame: groupBy(detections, ({ properties }) => properties.frame),
    intersections: layers.intersections.features.map(place),
    trajectory: lineOf(layers.trajectory.features[0]?.geometry),
    nodes: (layers.osm_nodes?.features ?? []).map(place),
    matches,
    places: (layers.places?.features ?? []).slice(1).map((/** @type {any} */ f) => lineOf(f.geometry)),
    buildings: ringsOf(layers.osm_buildings),
    roads: linesOf(layers.osm_roads),
    measured: linesOf(layers.roads),
    mouths: ringsOf(layers.junctions),
    surface: run.files?.includes("road.tif") ? `jobs/${job.id}/road` : null, // older versions made none
    roi_m: report?.roi_m ?? size,
    zone_m: report?.relevant_zone_m ?? (config.branches ? size - 2 * config.branches.outer_radius_m : null),
  };
}

/** @param {any} layer @returns {Array<{line: number[][], properties: any}>} */
const linesOf = (layer) =>
  (layer?.features ?? []).map((/** @type {any} */ f) => ({ line: lineOf(f.geometry), properties: toldOf(f) }));

/** The roads of the map that a job was scored against. @param {any} job */
export const loadRoads = async (job) => linesOf(await getJson(`jobs/${job.id}/layers/osm_roads`));

/** @param {any} layer Of polygons. @returns {number[][][]} */
const ringsOf = (layer) =>
  (layer?.features ?? []).flatMap((/** @type {any} */ f) =>
    f.geometry.type === "MultiPolygon" ? f.geometry.coordinates.flat() : f.geometry.coordinates,
  );

/**
 * The trajectory of a drive alone, for a job that still runs.
 * @param {any} job
 * @returns {Promise<Result|null>} null where the drive has none.
 */
export async function loadTrajectory(job) {
  const found = await getJson(`drives/${job.drive_id}/trajectory`).catch(() => null);
  const trajectory = lineOf(found?.features?.[0]?.geometry);
  if (!trajectory.length) return null;
  return { ...trackAlone(trajectory, found.local === true), job }; // local: metres of W
}

/**
 * A result of which nothing but the track is known.
 * @param {number[][]} trajectory
 * @param {boolean} local
 * @returns {Result}
 */
export function trackAlone(trajectory, local) {
  const frame = new Frame([], local);
  const seen = { keyframes: [], detections: [], intersections: [], byFrame: new Map(), surface: null };
  const drawn = { nodes: [], matches: [], roads: [], measured: [], mouths: [], buildings: [], places: [] };
  const scores = { report: null, isMadeUp: false, roi_m: 0, zone_m: null };
  return { ...seen, ...drawn, ...scores, job: null, run: {}, local, frame, trajectory };
}

/** The positions of a line; one across the antimeridian comes in parts. @param {any} geometry @returns {number[][]} */
export function lineOf(geometry) {
  return (geometry?.type === "MultiLineString" ? geometry.coordinates.flat() : geometry?.coordinates) ?? [];
}

/** Its properties, and the details that files of results have beside them. @param {any} feature */
const toldOf = ({ properties, details }) => ({ ...properties, ...details });

/** @param {any} feature @returns {Place} */
export function place(feature) {
  const [lng, lat] = feature.geometry.coordinates;
  return { lng, lat, properties: toldOf(feature) };
}

/** @param {any[]} features @param {Match[]} matches @param {boolean} evaluated @returns {Detection[]} */
function detectionsOf(features, matches, evaluated) {
  /** By id, or by place where the match is of a version without them. @param {number} frame @param {number[]} position */
  const key = (frame, position) => `${frame} ${position[0]} ${position[1]}`;
  const matched = new Map(matches.map((each) => [each.detection ?? key(each.frame, each.line[0]), each]));
  let number = 0;
  return features.map((feature, row) => {
    const { frame } = feature.properties;
    number = row > 0 && features[row - 1].properties.frame === frame ? number + 1 : 1;
    const isScored = evaluated && feature.properties.outcome !== "unscored";
    const pair = matched.get(`${frame}-${number}`) ?? matched.get(key(frame, feature.geometry.coordinates));
    return {
      ...place(feature),
      row,
      outcome: isScored ? /** @type {"TP"|"FP"} */ (pair?.outcome ?? "FP") : "none",
      error_m: pair?.error_m ?? null,
      osm_id: pair?.osm_id ?? null,
    };
  });
}
