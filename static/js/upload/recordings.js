/** Drives in files that only the service reads, as they were recorded: ROS bags, LAS and LAZ files, PCD files. */

import { getConfig } from "../api.js";
import { formatBytes, formatCount } from "../dom.js";

/** @typedef {"pcd" | "rosbag" | "las"} RecordedLayout */

const LAS = [".las", ".laz"];
/** Folders that such files may lie in, below that of the drive. */
const INSIDE = { pcd: /(^|\/)(pcd|clouds|velodyne|velodyne_points\/data)$/, las: /(^|\/)(las|laz)$/, rosbag: null };
/** What else of the folder belongs to the drive, besides what all layouts have. */
const BESIDE = {
  pcd: /^((poses|trajectory)\.tum|trajectory\.txt)$/,
  las: /^((las|laz)\/)?[^/]+\.(csv|txt|tum|out|sbet)$/i,
  rosbag: /^metadata\.yaml$/,
};
const POSES = {
  pcd: /^((poses|trajectory)\.(txt|tum))$/,
  las: /^((las|laz)\/)?(?!(calib[^/]*|times|timestamps)\.txt$|geo\.csv$)[^/]+\.(csv|txt|tum|out|sbet)$/i,
  rosbag: null,
};
const PART = /_\d+(?=\.[^.]+$)/; // of a bag in several files: drive_0.mcap, drive_1.mcap
const MAX_NAMED = 5;
const MAX_HEADER_BYTES = 65536;

/** @param {string} layout @returns {layout is RecordedLayout} */
export const isRecordedLayout = (layout) => layout in INSIDE;

/** @param {string} path @returns {RecordedLayout | null} null: the file is not a recording. */
export function recordedLayoutOf(path) {
  const { scans, recordings } = getConfig().file_kinds;
  if (scans.some((ending) => path.endsWith(ending))) return "pcd";
  const name = path.toLowerCase();
  if (!recordings.some((ending) => name.endsWith(ending))) return null;
  return LAS.some((ending) => name.endsWith(ending)) ? "las" : "rosbag";
}

/** @param {string} path @param {RecordedLayout} layout @returns {string} The folder of the drive that a file is of. */
function rootOf(path, layout) {
  const folder = path.slice(0, Math.max(0, path.lastIndexOf("/")));
  const inside = INSIDE[layout];
  return inside ? folder.replace(inside, "") : folder;
}

/**
 * Find the folders of recordings.
 *
 * @param {Map<string, File>} files By path.
 * @returns {Map<string, RecordedLayout>} By folder; where there are several kinds in one, that with the most bytes.
 */
export function findRecorded(files) {
  /** @type {Map<string, Map<RecordedLayout, number>>} */
  const sizes = new Map();
  for (const [path, file] of files) {
    const layout = recordedLayoutOf(path);
    if (!layout) continue;
    const root = rootOf(path, layout);
    const own = sizes.get(root) ?? new Map();
    own.set(layout, (own.get(layout) ?? 0) + file.size);
    sizes.set(root, own);
  }
  const largest = (/** @type {Map<RecordedLayout, number>} */ own) => [...own].sort((a, b) => b[1] - a[1])[0][0];
  return new Map([...sizes].map(([root, own]) => [root, largest(own)]));
}

/** @param {string} path Inside the drive. @param {RecordedLayout} layout @returns {boolean} */
export const isRecorded = (path, layout) => recordedLayoutOf(path) === layout && rootOf(path, layout) === "";

/** @param {string} path Inside the drive. @param {RecordedLayout} layout @returns {boolean} */
export const isBeside = (path, layout) => BESIDE[layout].test(path);

/** @param {string} path Inside the drive. @param {RecordedLayout} layout @returns {boolean} Whether it may hold the poses. */
export const mayBePoses = (path, layout) => POSES[layout]?.test(path) ?? false;

/**
 * Find what is wrong with recordings, by their names and sizes.
 *
 * @param {Map<string, File>} recorded By path inside the drive.
 * @param {Iterable<[string, File]>} others What is sent besides.
 * @param {RecordedLayout} layout
 * @returns {[path: string, message: string][]}
 */
export function recordingFaults(recorded, others, layout) {
  /** @type {[string, string][]} */
  const faults = [];
  const { max_file_bytes, max_recording_bytes, max_drive_bytes, max_drive_files } = getConfig().limits;
  const all = [...recorded, ...others];
  let bytes = 0;
  for (const [path, { size }] of all) {
    const isLong = layout !== "pcd" && recorded.has(path);
    const limit = isLong ? max_recording_bytes : max_file_bytes;
    const setting = isLong ? "INTERLOC_MAX_RECORDING_BYTES" : "INTERLOC_MAX_FILE_BYTES";
    bytes += size;
    if (size > limit) {
      const most = `the service takes files of at most ${formatBytes(limit)} (${setting})`;
      faults.push([
        path,
        `is too large: it has ${formatBytes(size)}, ${most}.${isLong ? " Split the recording." : ""}`,
      ]);
    } else if (size === 0 && recorded.has(path)) {
      faults.push([path, "is empty. Usual cause: a copy or download that did not finish."]);
    }
  }
  if (bytes > max_drive_bytes) {
    const most = `the service takes drives of at most ${formatBytes(max_drive_bytes)} (INTERLOC_MAX_DRIVE_BYTES)`;
    faults.push(["files", `are too large together: ${formatBytes(bytes)}, ${most}.`]);
  }
  if (all.length > max_drive_files) {
    const most = `the service takes at most ${formatCount(max_drive_files)} (INTERLOC_MAX_DRIVE_FILES)`;
    faults.push(["files", `are too many: ${formatCount(all.length)}, ${most}.`]);
  }
  const bags = layout === "rosbag" ? new Set([...recorded.keys()].map((path) => path.replace(PART, ""))) : new Set();
  if (bags.size > 1) {
    const names = [...recorded.keys()];
    const named = names.slice(1, MAX_NAMED).join(", ") + (names.length > MAX_NAMED ? ", …" : "");
    faults.push([
      names[0],
      `is not the only bag of the folder (${named}). Expected one drive: choose one bag as a file.`,
    ]);
  }
  return faults;
}

/**
 * @typedef {object} PcdFields What the points of a PCD file have.
 * @property {string} path
 * @property {string[]} names Of its fields; none in a .pcd.bin, which has no header.
 * @property {boolean} hasLabel
 */

/**
 * Read which fields the first PCD file has.
 *
 * @param {Map<string, File>} files By path.
 * @returns {Promise<PcdFields | null>} null where that cannot be told: the service judges the file.
 */
export async function readFields(files) {
  const [first] = [...files].sort(([a], [b]) => a.localeCompare(b, "en", { numeric: true })); // as the service numbers them
  if (!first) return null;
  const [path, file] = first;
  if (!path.endsWith(".pcd")) return { path, names: [], hasLabel: false };
  const header = /^(?:FIELDS|COLUMNS)[ \t]+(.*)$/m.exec(await file.slice(0, MAX_HEADER_BYTES).text());
  if (!header) return null;
  const names = header[1].trim().split(/\s+/);
  const { label_fields: known } = getConfig().file_kinds;
  return { path, names, hasLabel: names.some((name) => known.includes(name.toLowerCase())) };
}
