/**
 * The drives of a picked folder, as the service sees them.
 *
 * Only the browser has the folder. It sends the names and sizes of its files and the contents of the small ones; the
 * service answers which drive they are, what is wrong with it, where it went and what is to be sent.
 */

import { ApiError, getConfig, isMap, sendJson } from "../api.js";
import { formatBytes, plural } from "../dom.js";

/** @import { FileProblem } from "../api.js" */
/** @import { Folder } from "./folder.js" */
/**
 * @typedef {object} NumberedLook Files of a folder, by their numbers.
 * @property {string} folder Path inside the drive.
 * @property {string} suffix With its dot.
 * @property {number} digits Width that the numbers are padded to.
 * @property {[first: number, count: number][]} runs
 */
/**
 * @typedef {object} Track
 * @property {boolean} local Positions are metres, not degrees.
 * @property {number[][]} positions Where the scans were taken: longitude and latitude, or x and y.
 * @property {number[][] | null} fitted The poses laid over the georeference, turned and moved but not bent.
 * @property {number | null} fit_m Median distance of the two, metres.
 * @property {number} length_m
 */
/**
 * @typedef {object} DriveLook What the service found in a drive (`POST /drives/look`).
 * @property {string} root
 * @property {string} name
 * @property {string | null} layout
 * @property {NumberedLook | null} scans
 * @property {number | null} points_per_scan
 * @property {Record<string, NumberedLook & {problems: FileProblem[]}>} labels
 * @property {FileProblem[]} unlabelled What is wrong where neither label files nor a network are used.
 * @property {boolean | null} carries_labels Whether the points have labels; null: not known.
 * @property {boolean | null} has_poses false: the service computes them from the scans.
 * @property {Record<string, string>} whole Sent as they are: path in the drive -> path in the folder.
 * @property {Record<string, string>} small
 * @property {string[]} pose_files Files that may hold the poses of a recording.
 * @property {string[]} borrowed Notes on files that were taken from beside the drive.
 * @property {Record<string, number>} wanted Files whose first bytes would tell more.
 * @property {Record<string, [number, number][]>} wanted_ranges Parts of bags that would tell more.
 * @property {string | null} georeference
 * @property {string | null} georeference_reason
 * @property {Track | null} track
 * @property {number | null} keyframes
 * @property {number[]} frames_to_look_into
 * @property {FileProblem[]} problems
 */
/** @typedef {{root: string, name: string, kind: "bin" | "pcd" | "rosbag" | "las" | "reduced", files: number}} ListedName */

/**
 * @typedef {object} DriveFolder
 * @property {Folder} folder What was picked.
 * @property {string} name
 * @property {string} root Its path inside what was picked; "" where it is the folder itself.
 * @property {boolean} isLoose Its files were picked or dropped by themselves, without their folder.
 * @property {string} layout "unknown" where the service did not look.
 * @property {NumberedFiles | null} scans null of a reduced drive, and of one that only the service reads.
 * @property {Map<string, File>} recorded Of a drive that only the service reads: its scans, by path inside the drive.
 * @property {Map<string, File>} ground Of a reduced drive: its .ground files.
 * @property {Record<string, NumberedFiles>} labels By folder: labels, predictions.
 * @property {Map<string, File>} small What else of it is sent, by path inside the drive: poses, calibration, times, OXTS.
 * @property {Map<string, File>} maps OSM files.
 * @property {{files: number, bytes: number}} unused What the method does not need, as pictures.
 * @property {DriveLook | null} look null: the service was not reached, or refused.
 * @property {FileProblem[]} problems Of the drive, whichever its labels.
 */

export const LAYOUTS = /** @type {Record<string, string>} */ ({
  semantickitti: "SemanticKITTI / KITTI odometry",
  kitti_raw: "KITTI raw",
  kitti360: "KITTI-360",
  pcd: "PCD files",
  rosbag: "ROS bag",
  las: "LAS or LAZ files",
  reduced: "reduced drive",
});
const NEEDLESS = /\.(png|jpe?g|webp|tiff?|gif|mp4|avi|mkv)$/i;
const SMALL = /\.(txt|csv|tum|yaml|json)(\.gz)?$/i;
const MAX_SMALL_BYTES = 8e6;
const MAX_CONTENT_BYTES = 16e6; // the service takes 32 MB, and Base64 makes a third more of them
const MAX_CONTENTS = 20_000;
const READ_AT_ONCE = 64;
const MAX_TURNS = 6; // of asking for parts of a bag

/**
 * @typedef {object} Wish
 * @property {string} [root] The drive that is looked into; the first by default.
 * @property {object} [options] How it is read, as of the upload.
 * @property {Map<string, File>} [extras] Files from elsewhere, by their paths in the drive.
 */

/**
 * Let the service look into a folder.
 *
 * @param {Folder} folder
 * @param {Wish} [wish]
 * @returns {Promise<{drives: ListedName[], drive: DriveFolder | null, reason: string | null}>} `reason`: why there is no
 *   drive. Where the service cannot be asked, the drive is the folder as it is.
 */
export async function lookInto(folder, { root, options, extras = new Map() } = {}) {
  const front = root ? `${root}/` : "";
  const files = new Map([...folder.files].filter(([path]) => !NEEDLESS.test(path)));
  for (const [path, file] of extras) files.set(front + path, file);
  const sizes = Object.fromEntries([...files].map(([path, file]) => [path, file.size]));
  const small = new Map([...files].filter(([path, { size }]) => SMALL.test(path) && size <= MAX_SMALL_BYTES));
  const json = { name: folder.name.slice(0, 200) || "drive", files: sizes, root, options };
  const ask = (/** @type {object} */ more) => sendJson("POST", "drives/look", { ...json, ...more });
  try {
    let contents = await contentsOf(small);
    let answer = await ask({ contents });
    const wanted = /** @type {[string, number][]} */ (Object.entries(answer.drive?.wanted ?? {}));
    const heads = wanted.map(([path, bytes]) => [path, /** @type {File} */ (files.get(path)).slice(0, bytes)]);
    const more = await contentsOf(new Map(/** @type {[string, Blob][]} */ (heads)));
    contents = { ...contents, ...more };
    if (Object.keys(more).length) answer = await ask({ root: answer.drive.root, contents });
    /** @type {Record<string, Record<string, string>>} */
    const ranges = {};
    for (let turn = 0; turn < MAX_TURNS && Object.keys(answer.drive?.wanted_ranges ?? {}).length; turn += 1) {
      for (const [path, pieces] of /** @type {[string, [number, number][]][]} */ (
        Object.entries(answer.drive.wanted_ranges)
      ))
        for (const [start, stop] of pieces)
          (ranges[path] ??= {})[start] = await base64Of(/** @type {File} */ (files.get(path)).slice(start, stop));
      answer = await ask({ root: answer.drive.root, contents, ranges });
    }
    return { ...answer, drive: answer.drive && driveOf(folder, answer.drive) };
  } catch (fault) {
    if (!(fault instanceof ApiError)) throw fault;
    return { drives: [], drive: unseen(folder, fault), reason: null };
  }
}

/**
 * @param {Map<string, Blob>} files
 * @returns {Promise<Record<string, string>>} Base64, by path; nothing where that is too much for one request.
 */
async function contentsOf(files) {
  /** @type {Record<string, string>} */
  const contents = {};
  const all = [...files];
  if (all.length > MAX_CONTENTS || all.reduce((sum, [, { size }]) => sum + size, 0) > MAX_CONTENT_BYTES)
    return contents;
  for (let i = 0; i < all.length; i += READ_AT_ONCE) {
    const part = all.slice(i, i + READ_AT_ONCE);
    const texts = await Promise.all(part.map(([, file]) => base64Of(file)));
    part.forEach(([path], row) => (contents[path] = texts[row]));
  }
  return contents;
}

/** @param {Blob} file */
async function base64Of(file) {
  const bytes = new Uint8Array(await file.arrayBuffer());
  let text = "";
  for (let i = 0; i < bytes.length; i += 8192) text += String.fromCharCode(...bytes.subarray(i, i + 8192));
  return btoa(text);
}

/** The files of a drive that the service has found in a folder. @param {Folder} folder @param {DriveLook} look */
export function driveOf(folder, look) {
  const front = look.root ? `${look.root}/` : "";
  const filesOf = (/** @type {Record<string, string>} */ paths) =>
    new Map(
      Object.entries(paths).flatMap(([inside, path]) => {
        const file = folder.files.get(path);
        return file ? [/** @type {[string, File]} */ ([inside, file])] : []; // else it is from elsewhere
      }),
    );
  const numbered = (/** @type {NumberedLook} */ each) => numberedFiles(folder, front, each);
  const layout = look.layout ?? "unknown";
  const whole = filesOf(look.whole);
  const maps = mapsOf(folder, front);
  /** @type {DriveFolder} */
  const drive = {
    folder,
    name: look.name,
    root: look.root,
    isLoose: folder.isLoose ?? false,
    layout,
    scans: look.scans && numbered(look.scans),
    recorded: layout === "reduced" ? new Map() : whole,
    ground: layout === "reduced" ? whole : new Map(),
    labels: Object.fromEntries(Object.entries(look.labels).map(([name, each]) => [name, numbered(each)])),
    small: filesOf(look.small),
    maps,
    unused: { files: 0, bytes: 0 },
    look,
    problems: look.problems,
  };
  const used = new Set(filesOfDrive(drive).map(([, file]) => file));
  for (const [path, file] of folder.files) {
    if (!path.startsWith(front) || used.has(file) || maps.has(path.slice(front.length))) continue;
    drive.unused.files += 1;
    drive.unused.bytes += file.size;
  }
  return drive;
}

/**
 * A folder that the service did not look into: all of it is sent as it is.
 *
 * @param {Folder} folder
 * @param {ApiError} fault
 * @returns {DriveFolder}
 */
function unseen(folder, fault) {
  const maps = mapsOf(folder, "");
  const recorded = new Map([...folder.files].filter(([path]) => !maps.has(path) && !NEEDLESS.test(path)));
  const bytes = [...recorded.values()].reduce((sum, { size }) => sum + size, 0);
  const message =
    `The service did not look into it: ${fault.message} Without its answer all ${plural(recorded.size, "file")} ` +
    `(${formatBytes(bytes)}) would be sent as they are, and be checked there. Scans are reduced in the browser only ` +
    "where the service has said what they are.";
  const { name, isLoose = false } = folder;
  const nothing = { scans: null, ground: new Map(), labels: {}, small: new Map(), look: null };
  const unused = { files: folder.files.size - recorded.size - maps.size, bytes: 0 };
  const problems = [{ severity: "warning", path: name, message }];
  return { ...nothing, folder, name, root: "", isLoose, layout: "unknown", recorded, maps, unused, problems };
}

/** @param {Folder} folder @param {string} front @returns {Map<string, File>} OSM files that lie in a drive itself. */
function mapsOf({ files }, front) {
  const own = [...files].filter(([path]) => path.startsWith(front) && isMap(path));
  return new Map(
    own.flatMap(([path, file]) => (path.includes("/", front.length) ? [] : [[path.slice(front.length), file]])),
  );
}

/** @param {DriveFolder} drive @returns {[string, File][]} All files of it but maps, by their paths or numbers. */
export function filesOfDrive(drive) {
  const numbered = [drive.scans, ...Object.values(drive.labels)].filter((each) => each !== null);
  /** @type {[string, File][]} */
  const files = [...drive.small, ...drive.ground, ...drive.recorded];
  for (const { folder, files: own } of numbered)
    for (const [number, file] of own) files.push([`${folder}/${number}`, file]);
  return files;
}

/** @typedef {Omit<NumberedLook, "runs"> & {files: Map<number, File>, bytes: number}} NumberedFiles By number, ascending. */

/** @param {Folder} picked @param {string} front Path of the drive in it. @param {NumberedLook} look @returns {NumberedFiles} */
function numberedFiles(picked, front, { folder, suffix, digits, runs }) {
  const found = { folder, suffix, digits, files: new Map(), bytes: 0 };
  for (const [first, count] of runs) {
    for (let number = first; number < first + count; number += 1) {
      const file = picked.files.get(front + pathOf(found, number));
      if (!file) continue;
      found.files.set(number, file);
      found.bytes += file.size;
    }
  }
  return found;
}

/** @param {NumberedFiles} numbered @param {number} number @returns {string} Path inside the drive. */
export function pathOf(numbered, number) {
  return `${numbered.folder}/${String(number).padStart(numbered.digits, "0")}${numbered.suffix}`;
}

/** @param {Iterable<number>} numbers Ascending. @returns {[number, number][]} Runs: [first, count]. */
export function runsOf(numbers) {
  /** @type {[number, number][]} */
  const runs = [];
  for (const number of numbers) {
    const last = runs.at(-1);
    if (last && last[0] + last[1] === number) last[1] += 1;
    else runs.push([number, 1]);
  }
  return runs;
}

const ORDER = ["error", "warning", "note"];

/** @param {FileProblem[]} problems @returns {FileProblem[]} Errors first. */
export function sorted(problems) {
  return [...problems].sort((a, b) => ORDER.indexOf(a.severity) - ORDER.indexOf(b.severity));
}

/**
 * What is wrong with, or worth knowing of, a drive.
 *
 * @param {DriveFolder} drive
 * @param {string[]} folders Label folders that are to be sent.
 * @param {boolean} isMade Whether the service makes the labels.
 * @returns {FileProblem[]} Errors first.
 */
export function problemsOf({ look, labels, layout, problems }, folders, isMade) {
  if (!look) return problems;
  const ofNone = isMade ? [] : look.unlabelled;
  const ofLabels = Object.keys(labels).length ? folders.flatMap((name) => look.labels[name]?.problems ?? []) : ofNone;
  const { georeference_reason: reason } = look;
  const message = `${reason}: place the drive on the map by its roads, or add a file of OXTS rows or a geo.csv below. Otherwise the result is in local metres and cannot be scored against OpenStreetMap.`;
  const note = reason && layout !== "reduced" ? [{ severity: "note", path: "georeference", message }] : [];
  return sorted([...problems, ...ofLabels, ...note]);
}

/**
 * Write the OXTS files of a KITTI raw drive as one file with one row per frame, the first for frame 0 of the sequence.
 *
 * @param {Folder} folder What was picked: the raw drive, or its oxts/.
 * @param {(done: number, total: number) => void} [onProgress]
 */
export async function oxtsRows(folder, onProgress = () => {}) {
  const found = [...folder.files].flatMap(([path, file]) => {
    const match = /^(?:(?:.*\/)?oxts\/)?(?:data\/)?(\d+)\.txt$/.exec(path);
    return match && !/(^|\/)(image_\d\d|velodyne_points)\//.test(path)
      ? [{ number: Number(match[1]), path, file }]
      : [];
  });
  const places = new Set(found.map(({ path }) => path.slice(0, path.lastIndexOf("/") + 1)));
  const several = [...places].slice(0, 3).join(", ");
  if (places.size > 1) throw new Error(`${folder.name} holds several OXTS folders (${several}): pick one drive.`);
  found.sort((a, b) => a.number - b.number);
  if (!found.length || found.some(({ number }, i) => number !== i)) {
    const what = found.length ? "frames are missing among its OXTS files" : "no OXTS file is in it";
    throw new Error(`${folder.name}: ${what}. Expected a KITTI raw drive with oxts/data/0000000000.txt and so on.`);
  }
  const drive = `${folder.name}/${found[0].path}`;
  const first = Object.entries(getConfig().raw_first_frames).find(([name]) => drive.includes(name))?.[1] ?? 0;
  const rows = [];
  for (const { file } of found.slice(first)) {
    rows.push((await file.text()).trim().replaceAll(/\s+/g, " "));
    if (rows.length % 200 === 0) onProgress(rows.length, found.length - first);
  }
  return new File([`${rows.join("\n")}\n`], `${folder.name}.oxts.txt`, { lastModified: found[0].file.lastModified });
}
