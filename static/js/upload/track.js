/**
 * Where a drive went, as far as the browser can tell from its small files: poses and fixes by scan number.
 *
 * For a look before anything is sent; the service reads the same files with more care.
 */

/** @typedef {NonNullable<import("../api.js").PageConfig["kitti360_world"]>} World Of KITTI-360. */
/**
 * @typedef {object} TrackFiles
 * @property {number[]} frames Numbers of the scans, ascending; none where only the service can tell.
 * @property {File | null} poses KITTI, KITTI-360 or TUM.
 * @property {string} pose_frame auto, camera, lidar
 * @property {World | null} world In which the poses are, where they are those of KITTI-360.
 * @property {File | null} fixes geo.csv, or one row of OXTS per frame.
 * @property {[number, File][]} oxts Files of one fix each, by frame.
 */

/**
 * @typedef {object} Track
 * @property {boolean} local Positions are metres, not degrees.
 * @property {number[][]} scans Where the scans were taken: longitude and latitude, or x and y.
 * @property {number[][] | null} fitted The poses laid over the fixes, turned and moved but not bent.
 * @property {number | null} fit_m Median distance of the two, metres.
 * @property {number} length_m
 */

const MAX_BYTES = 64e6;
const MAX_POSITIONS = 50_000;
const MAX_FIX_FILES = 1000;
const READ_AT_ONCE = 16;
const LINE_BYTES = 400; // a fix begins with latitude and longitude
const METRES_PER_DEGREE = 111_320;
const WGS84_A_M = 6_378_137;

/** @param {TrackFiles} files @returns {Promise<Track | null>} null: only the service can read where the drive went. */
export async function readTrack({ frames, poses, pose_frame, world, fixes, oxts }) {
  const placed = poses && world && !fixes ? readWorldPoses(await textOf(poses), world) : null;
  if (placed?.size) return trackOf(placed, frames, false, null);
  const fixed = oxts.length ? await readFixFiles(oxts, frames) : fixes ? readFixes(await textOf(fixes), frames) : null;
  const posed = poses ? readPoses(await textOf(poses), frames, pose_frame) : null;
  const found = fixed?.size ? fixed : posed;
  return found?.size ? trackOf(found, frames, found === posed, posed) : null;
}

/**
 * @param {Map<number, number[]>} found Positions by frame.
 * @param {number[]} frames
 * @param {boolean} local
 * @param {Map<number, number[]> | null} posed To be laid over positions that are not local.
 * @returns {Track}
 */
function trackOf(found, frames, local, posed) {
  const wanted = thin([...(frames.length ? frames : found.keys())].filter((frame) => found.has(frame)));
  const scans = wanted.map((frame) => /** @type {number[]} */ (found.get(frame)));
  const fit = !local && posed ? fitOf(wanted, found, posed) : null;
  const metres = local ? scans : scans.map((each) => toMetres(each, scans[0]));
  return { local, scans, fitted: fit?.line ?? null, fit_m: fit?.error_m ?? null, length_m: lengthOf(metres) };
}

/** @param {File} file @returns {Promise<string>} */
async function textOf(file) {
  if (file.size > MAX_BYTES) return "";
  const isPacked = /\.gz$/i.test(file.name);
  const stream = isPacked ? file.stream().pipeThrough(new DecompressionStream("gzip")) : file.stream();
  return new Response(stream).text();
}

/** @template T @param {T[]} items @returns {T[]} */
function thin(items) {
  const step = Math.ceil(items.length / MAX_POSITIONS);
  return step > 1 ? items.filter((_, i) => i % step === 0) : items;
}

/**
 * Which row of a file is which scan's: by its number, or one to one.
 *
 * @template T
 * @param {T[]} rows
 * @param {number[]} frames
 * @returns {Map<number, T>}
 */
function byFrame(rows, frames) {
  const last = frames.at(-1);
  if (last === undefined || last < rows.length) return new Map(rows.map((row, i) => [i, row]));
  return rows.length === frames.length ? new Map(rows.map((row, i) => [frames[i], row])) : new Map();
}

/** @param {string} text @returns {string[]} */
const linesOf = (text) => text.split("\n").filter((line) => line.trim());

/** @param {number} lat @param {number} lon */
const isPlace = (lat, lon) => Math.abs(lat) <= 90 && Math.abs(lon) <= 180 && (lat !== 0 || lon !== 0);

/**
 * @param {string} text A geo.csv, or rows of OXTS.
 * @param {number[]} frames
 * @returns {Map<number, number[]>} Longitude and latitude by frame.
 */
export function readFixes(text, frames) {
  const lines = linesOf(text);
  const header = lines[0]?.split(",").map((name) => name.trim()) ?? [];
  const [frame, lat, lon] = ["frame", "lat_deg", "lon_deg"].map((name) => header.indexOf(name));
  if (frame >= 0 && lat >= 0 && lon >= 0) {
    const rows = lines.slice(1).map((line) => line.split(",").map(Number));
    return new Map(rows.filter((row) => isPlace(row[lat], row[lon])).map((row) => [row[frame], [row[lon], row[lat]]]));
  }
  const rows = byFrame(lines, frames);
  const places = [...rows].map(([number, line]) => [number, line.trim().split(/\s+/, 2).map(Number)]);
  return new Map(
    /** @type {[number, number[]][]} */ (places)
      .filter(([, [latitude, longitude]]) => isPlace(latitude, longitude))
      .map(([number, [latitude, longitude]]) => [number, [longitude, latitude]]),
  );
}

/** @param {[number, File][]} files @param {number[]} frames @returns {Promise<Map<number, number[]>>} */
async function readFixFiles(files, frames) {
  const wanted = new Set(frames);
  const own = files.filter(([frame]) => !wanted.size || wanted.has(frame)).sort((a, b) => a[0] - b[0]);
  const step = Math.max(1, Math.ceil(own.length / MAX_FIX_FILES));
  const some = own.filter((_, i) => i % step === 0 || i === own.length - 1);
  /** @type {Map<number, number[]>} */
  const found = new Map();
  for (let i = 0; i < some.length; i += READ_AT_ONCE) {
    const part = some.slice(i, i + READ_AT_ONCE);
    const texts = await Promise.all(part.map(([, file]) => file.slice(0, LINE_BYTES).text()));
    part.forEach(([frame], row) => {
      const [lat, lon] = texts[row].trim().split(/\s+/, 2).map(Number);
      if (isPlace(lat, lon)) found.set(frame, [lon, lat]);
    });
  }
  return found;
}

/** Where the numbers of a pose stand in its line, by how many there are: frame, position, rows of the rotation. */
const FORMS = /** @type {Record<number, {frame: number | null, at: number[], turn: number[] | null}>} */ ({
  8: { frame: null, at: [1, 2, 3], turn: null }, // TUM: time, position, quaternion
  12: { frame: null, at: [3, 7, 11], turn: [0, 1, 2, 4, 5, 6, 8, 9, 10] },
  13: { frame: 0, at: [4, 8, 12], turn: [1, 2, 3, 5, 6, 7, 9, 10, 11] },
  17: { frame: 0, at: [4, 8, 12], turn: [1, 2, 3, 5, 6, 7, 9, 10, 11] },
});

/**
 * Read poses as positions on the ground: x forward and y left of the first pose.
 *
 * @param {string} text
 * @param {number[]} frames
 * @param {string} pose_frame auto: cameras look along z, LiDARs along x, and vehicles drive forwards.
 * @returns {Map<number, number[]>}
 */
export function readPoses(text, frames, pose_frame) {
  const poses = posesIn(text);
  const [first] = poses;
  if (!first) return new Map();
  const isCamera = pose_frame === "camera" || (pose_frame === "auto" && areOfCamera(poses));
  const places = poses.map(({ at }) => {
    const [x, y, z] = intoFrame(first.turn, difference(at, first.at));
    return isCamera ? [z, -x] : [x, y];
  });
  if (first.frame === null) return byFrame(places, frames);
  return new Map(poses.map(({ frame }, i) => [/** @type {number} */ (frame), places[i]]));
}

/** @typedef {{frame: number | null, at: number[], turn: number[] | null}} Pose */

/** @param {string} text @returns {Pose[]} */
export function posesIn(text) {
  /** @type {Pose[]} */
  const poses = [];
  for (const line of linesOf(text)) {
    const numbers = line.trim().split(/\s+/).map(Number);
    const form = FORMS[numbers.length];
    if (!form || !numbers.every(Number.isFinite)) continue;
    const frame = form.frame === null ? null : numbers[form.frame];
    poses.push({ frame, at: form.at.map((i) => numbers[i]), turn: form.turn?.map((i) => numbers[i]) ?? null });
  }
  return poses;
}

/** @param {Pose[]} poses @returns {boolean} Whether they move along z, as cameras do, rather than along x. */
export function areOfCamera(poses) {
  const forward = [0, 0, 0];
  poses.slice(1).forEach(({ at }, i) => {
    const step = intoFrame(poses[i].turn, difference(at, poses[i].at));
    for (const axis of [0, 1, 2]) forward[axis] += Math.abs(step[axis]);
  });
  return poses.length > 0 && poses[0].turn !== null && forward[2] > forward[0];
}

/** @param {number[]} a @param {number[]} b */
const difference = (a, b) => a.map((value, i) => value - b[i]);

/**
 * @param {string} text Poses of KITTI-360: its world is a spherical Mercator projection.
 * @param {World} world
 * @returns {Map<number, number[]>} Longitude and latitude by frame; none where they were moved elsewhere.
 */
export function readWorldPoses(text, world) {
  const radians = Math.PI / 180;
  const scale = WGS84_A_M * Math.cos(world.lat_deg * radians);
  const north = Math.asinh(Math.tan(world.lat_deg * radians));
  const rows = linesOf(text).map((line) => line.trim().split(/\s+/).map(Number));
  const posed = rows.filter((row) => (row.length === 13 || row.length === 17) && row.every(Number.isFinite));
  const heights = posed.map((row) => row[12]).sort((a, b) => a - b);
  const height = heights[heights.length >> 1];
  if (!(height > world.min_alt_m && height < world.max_alt_m)) return new Map();
  return new Map(
    posed.map((row) => [
      row[0],
      [world.lon_deg + row[4] / scale / radians, Math.atan(Math.sinh(north + row[8] / scale)) / radians],
    ]),
  );
}

/** @param {number[] | null} turn Rows of a rotation, null for none. @param {number[]} v @returns {number[]} Turned back. */
function intoFrame(turn, [x, y, z]) {
  if (!turn) return [x, y, z];
  return [0, 1, 2].map((i) => turn[i] * x + turn[3 + i] * y + turn[6 + i] * z);
}

/** @param {number[]} place Longitude, latitude. @param {number[]} origin @returns {number[]} East and north, metres. */
export function toMetres([lon, lat], origin) {
  const parallel = METRES_PER_DEGREE * Math.cos((origin[1] * Math.PI) / 180);
  return [(lon - origin[0]) * parallel, (lat - origin[1]) * METRES_PER_DEGREE];
}

/** @param {number[][]} metres */
function lengthOf(metres) {
  let sum = 0;
  for (let i = 1; i < metres.length; i += 1) {
    sum += Math.hypot(metres[i][0] - metres[i - 1][0], metres[i][1] - metres[i - 1][1]);
  }
  return sum;
}

/**
 * Lay poses over fixes by a turn and a shift (least squares): what belongs together then lies together.
 *
 * @param {number[]} frames
 * @param {Map<number, number[]>} fixes
 * @param {Map<number, number[]>} poses
 * @returns {{line: number[][], error_m: number} | null}
 */
function fitOf(frames, fixes, poses) {
  const both = frames.filter((frame) => poses.has(frame));
  if (both.length < 3) return null;
  const origin = /** @type {number[]} */ (fixes.get(both[0]));
  const target = both.map((frame) => toMetres(/** @type {number[]} */ (fixes.get(frame)), origin));
  const source = both.map((frame) => /** @type {number[]} */ (poses.get(frame)));
  const mean = (/** @type {number[][]} */ all) => [0, 1].map((i) => all.reduce((sum, p) => sum + p[i], 0) / all.length);
  const [from, to] = [mean(source), mean(target)];
  let cos = 0;
  let sin = 0;
  source.forEach(([x, y], i) => {
    const [a, b] = [x - from[0], y - from[1]];
    const [c, d] = [target[i][0] - to[0], target[i][1] - to[1]];
    cos += a * c + b * d;
    sin += a * d - b * c;
  });
  const angle = Math.atan2(sin, cos);
  const [c, s] = [Math.cos(angle), Math.sin(angle)];
  const laid = source.map(([x, y]) => {
    const [a, b] = [x - from[0], y - from[1]];
    return [to[0] + c * a - s * b, to[1] + s * a + c * b];
  });
  const errors = laid.map(([x, y], i) => Math.hypot(x - target[i][0], y - target[i][1])).sort((a, b) => a - b);
  const parallel = METRES_PER_DEGREE * Math.cos((origin[1] * Math.PI) / 180);
  const line = laid.map(([x, y]) => [origin[0] + x / parallel, origin[1] + y / METRES_PER_DEGREE]);
  return { line, error_m: errors[Math.floor(errors.length / 2)] };
}
