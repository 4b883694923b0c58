/** The result of a job: its layers and report, loaded together. */
import { ApiError, getJson } from "../api.js";
import { groupBy } from "../dom.js";
import { Frame } from "./frame.js";

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
 * @property {import("./compared.js").Compared[]} compared Beside those of other jobs; empty where none are compared.
 * @property {number[][][]} buildings Outlines of those of the map near the track, and of their holes, the other way round.
 * @property {number[][][]} places Where else on the map the drive might have been, if it was placed by its roads.
 * @property {string|null} surface Path of the road seen by LiDAR; null where the result has none.
 * @property {number} roi_m Side S of the region of interest.
 * @property {number|null} zone_m Side S - 2 a_o of the relevant zone.
 */

const KEPT = 3;
/** @type {Map<string, Promise<Result>>} */
const cache = new Map();

/** Load the result of a successful job; the last few are kept. @param {any} job @returns {Promise<Result>} */
export function loadResult(job) {
  let result = cache.get(job.id);
  if (!result) {
    result = load(job);
    result.catch(() => cache.delete(job.id));
    cache.set(job.id, result);
    const [oldest] = cache.keys();
    if (cache.size > KEPT) cache.delete(oldest);
  }
  return result;
}

/** @param {any} job @returns {Promise<Result>} */
async function load(job) {
  const at = `jobs/${job.id}`;
  const run = await getJson(`${at}/files/run.json`);
  const local = !run.georeferenced;
  /** @param {string} name */
  const layer = (name) => getJson(local ? `${at}/files/${name}.local.json` : `${at}/layers/${name}`);
  /** @param {string} name */
  const evaluated = (name) => (local || !job.request.osm ? Promise.resolve(null) : orNull(getJson(`${at}/${name}`)));
  const isPlaced = Boolean(run.location);
  const [keyframes, detections, intersections, trajectory, report, nodes, matches, roads, places] = await Promise.all([
    ...["keyframes", "detections", "intersections", "trajectory"].map(layer),
    ...["report", "layers/osm_nodes", "layers/matches", "layers/osm_roads"].map(evaluated),
    isPlaced ? orNull(getJson(`${at}/layers/places`)) : null,
  ]);
  const buildings = report?.osm?.buildings ? await orNull(getJson(`${at}/layers/osm_buildings`)) : null; // few maps have any
  const hasRoads = (run.files ?? []).some((/** @type {string} */ name) => name.startsWith("roads.")); // likewise
  const [measured, junctions] = hasRoads
    ? await Promise.all(["roads", "junctions"].map((name) => orNull(layer(name))))
    : [];
  const hasSurface = (run.files ?? []).includes("road.tif"); // older versions made none

  const points = keyframes.features.map(place);
  /** @type {Match[]} */
  const pairs = linesOf(matches).map(({ line, properties }) => ({ ...properties, line }));
  const found = detectionsOf(detections.features, pairs, report !== null);
  const config = run.config ?? {};
  const size = config.bev?.size_m ?? 120;
  return {
    job,
    run,
    report,
    isMadeUp: report?.osm?.made_up === true,
    local,
    frame: new Frame(points, local),
    keyframes: points,
    detections: found,
    byFrame: groupBy(found, ({ properties }) => properties.frame),
    intersections: intersections.features.map(place),
    trajectory: lineOf(trajectory.features[0]?.geometry),
    nodes: (nodes?.features ?? []).map(place),
    matches: pairs,
    compared: [],
    places: (places?.features ?? []).slice(1).map((/** @type {any} */ f) => lineOf(f.geometry)),
    buildings: ringsOf(buildings),
    roads: linesOf(roads),
    measured: linesOf(measured),
    mouths: ringsOf(junctions),
    surface: hasSurface ? `${at}/road` : null,
    roi_m: report?.roi_m ?? size,
    zone_m: report?.relevant_zone_m ?? (config.branches ? size - 2 * config.branches.outer_radius_m : null),
  };
}

/** @param {any} layer @returns {Array<{line: number[][], properties: any}>} */
const linesOf = (layer) =>
  (layer?.features ?? []).map((/** @type {any} */ f) => ({ line: lineOf(f.geometry), properties: toldOf(f) }));

/** The roads of the map that a job was scored against. @param {any} job */
export const loadRoads = async (job) => linesOf(await orNull(getJson(`jobs/${job.id}/layers/osm_roads`)));

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
  const seen = { keyframes: [], detections: [], intersections: [], byFrame: new Map(), surface: null, compared: [] };
  const drawn = { nodes: [], matches: [], roads: [], measured: [], mouths: [], buildings: [], places: [] };
  const scores = { report: null, isMadeUp: false, roi_m: 0, zone_m: null };
  return { ...seen, ...drawn, ...scores, job: null, run: {}, local, frame, trajectory };
}

/** @param {Promise<any>} answer @returns {Promise<any>} null where the result has no such part. */
async function orNull(answer) {
  try {
    return await answer;
  } catch (error) {
    if (error instanceof ApiError && error.status === 404) return null;
    throw error;
  }
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

/**
 * The same result with service roads counted as roads of the map; its detections keep their verdicts.
 * @param {Result} result Whose report has `with_service`.
 * @returns {Result}
 */
export function withService(result) {
  const report = { ...result.report, ...result.report.with_service };
  const told = new Map(report.intersections.map((/** @type {any} */ each) => [each.id, each]));
  return {
    ...result,
    report,
    intersections: result.intersections.map((each) => ({
      ...each,
      properties: { ...each.properties, ...told.get(each.properties.id) },
    })),
    nodes: report.nodes.map((/** @type {any} */ node) => ({ lng: node.lon, lat: node.lat, properties: node })),
  };
}

/**
 * The median error of the detections of a node: of the true ones where it has any, since a wrong one is no measure of
 * how well it was found.
 * @param {Result} result
 * @param {any} node Its properties.
 * @returns {number|null}
 */
export function medianError({ matches }, { osm_id, median_error_m }) {
  const isTrue = (/** @type {Match} */ each) => each.osm_id === osm_id && each.outcome === "TP";
  const errors = matches.filter(isTrue).map((each) => each.error_m);
  if (!errors.length) return median_error_m;
  errors.sort((a, b) => a - b);
  const half = errors.length >> 1;
  return errors.length % 2 ? errors[half] : (errors[half - 1] + errors[half]) / 2;
}
