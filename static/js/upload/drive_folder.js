/**
 * Which drives a picked folder holds, which of its files belong to them, and what is wrong by their names and sizes.
 *
 * Only the browser sees the folder, so what is missing or cut short is reported here, before anything is sent. The
 * service judges all that has to be read: poses, georeference, labels, calibration.
 */

import { getConfig, isMap } from "../api.js";
import { LABEL_FOLDERS } from "../data/lists.js";
import { formatCount, plural } from "../dom.js";
import {
  findRecorded,
  isBeside,
  isRecorded,
  isRecordedLayout,
  mayBePoses,
  readFields,
  recordedLayoutOf,
  recordingFaults,
} from "./recordings.js";
import { sizeComplaint } from "./reduce.js";
import { areOfCamera, posesIn } from "./track.js";

/** @typedef {import("../api.js").FileProblem} FileProblem */
/** @typedef {import("./recordings.js").PcdFields} PcdFields */

/**
 * @typedef {object} DriveFolder
 * @property {string} name
 * @property {string} root Its path inside what was picked; "" where it is the folder itself.
 * @property {boolean} isLoose Its files were picked or dropped by themselves, without their folder.
 * @property {"semantickitti" | "kitti_raw" | "kitti360" | "reduced" | import("./recordings.js").RecordedLayout} layout
 * @property {NumberedFiles | null} scans null of a reduced drive, and of one that only the service reads.
 * @property {Map<string, File>} recorded Of a drive that only the service reads: its scans, by path inside the drive.
 * @property {PcdFields | null} fields Of a drive of PCD files, where their header can be read.
 * @property {Record<string, NumberedFiles>} labels By folder: labels, predictions.
 * @property {Map<string, File>} small What else of it is sent, by path inside the drive: poses, calibration, times, OXTS.
 * @property {boolean} lacksCalibration Its poses are those of a camera, and calib.txt is not there.
 * @property {Map<string, File>} maps OSM files.
 * @property {Map<string, File>} ground Of a reduced drive: its .ground files.
 * @property {string[]} borrowed Notes on files that were taken from beside the drive.
 * @property {{files: number, bytes: number}} unused What the method does not need, as pictures.
 * @property {FileProblem[]} problems Of names.
 */

export const LAYOUTS = {
  semantickitti: "SemanticKITTI / KITTI odometry",
  kitti_raw: "KITTI raw",
  kitti360: "KITTI-360",
  pcd: "PCD files",
  rosbag: "ROS bag",
  las: "LAS or LAZ files",
  reduced: "reduced drive",
};
const SCAN_FOLDERS = ["velodyne", "velodyne_points/data"];
const SMALL = [
  /^(poses|cam0_to_world|times|timestamps)\.txt$/,
  /^calib[^/]*\.txt$/,
  /^calibration\/[^/]+\.txt$/,
  /^geo\.csv$/,
  /^oxts\/([^/]+\/)?[^/]+\.txt(\.gz)?$/,
  /^velodyne_points\/timestamps[^/]*\.txt$/,
];
const PUBLISHED_POSES = /^((poses|cam0_to_world)|oxts\/([^/]+\/)?[^/]+)\.txt$/; // of a drive of KITTI-360
const INDEXED_LENGTHS = [13, 17]; // numbers per pose line that starts with its frame

/**
 * Find the drives in a folder: in itself, or in folders below it.
 *
 * @param {import("./folder.js").Folder} folder
 * @returns {Promise<DriveFolder[]>} In the order of their paths.
 */
export async function findDrives(folder) {
  /** @type {Map<string, "scans" | "reduced" | import("./recordings.js").RecordedLayout>} */
  const roots = new Map();
  for (const path of folder.files.keys()) {
    const match = /^(?:(.*)\/)?(?:(velodyne|velodyne_points\/data)\/[^/]+\.bin|(reduced\.json))$/.exec(path);
    if (!match || recordedLayoutOf(path)) continue;
    const root = match[1] ?? "";
    if (roots.get(root) !== "reduced") roots.set(root, match[3] ? "reduced" : "scans");
  }
  const usual = [...roots.keys()];
  for (const [root, layout] of findRecorded(folder.files)) {
    // What lies in, or around, a drive that the browser can reduce is that drive's: a map as a point cloud, its bag.
    if (!usual.some((other) => isWithin(other, root) || isWithin(root, other))) roots.set(root, layout);
  }
  const byRoot = new Map([...roots.keys()].map((root) => [root, new Map()]));
  for (const [path, file] of folder.files) {
    let end = path.lastIndexOf("/");
    while (end > 0 && !byRoot.has(path.slice(0, end))) end = path.lastIndexOf("/", end - 1);
    if (end > 0) byRoot.get(path.slice(0, end))?.set(path.slice(end + 1), file);
    else byRoot.get("")?.set(path, file);
  }
  const calibration = [...folder.files.keys()].filter((path) =>
    /(^|\/)(calib[^/]*|calibration\/[^/]+)\.txt$/.test(path),
  );
  const sorted = [...roots].sort(([a], [b]) => (a < b ? -1 : 1));
  return Promise.all(
    sorted.map(([root, kind]) => readDrive({ folder, root, inside: byRoot.get(root) ?? new Map(), kind, calibration })),
  );
}

/** @param {string} path @param {string} folder @returns {boolean} Whether it is the folder, or lies in it. */
const isWithin = (path, folder) => folder === "" || path === folder || path.startsWith(`${folder}/`);

/**
 * @param {{folder: import("./folder.js").Folder, root: string, inside: Map<string, File>,
 *   kind: "scans" | "reduced" | import("./recordings.js").RecordedLayout, calibration: string[]}} found `inside`: its files by path inside it; `calibration`: paths of all such files.
 * @returns {Promise<DriveFolder>}
 */
async function readDrive({ folder, root, inside, kind, calibration }) {
  /** @type {FileProblem[]} */
  const problems = [];
  /** @type {DriveFolder} */
  const drive = {
    name: root ? /** @type {string} */ (root.split("/").pop()) : folder.name,
    root,
    isLoose: folder.isLoose ?? false,
    layout: kind === "scans" ? "semantickitti" : kind,
    scans: null,
    recorded: new Map(),
    fields: null,
    labels: {},
    small: new Map(),
    lacksCalibration: false,
    maps: new Map(),
    ground: new Map(),
    borrowed: [],
    unused: { files: 0, bytes: 0 },
    problems,
  };
  const numbered = sortFiles(drive, inside);
  if (kind !== "reduced") {
    for (const name of kind === "scans" ? SCAN_FOLDERS : []) {
      drive.scans ??= numberedFiles(numbered.get(name) ?? new Map(), name, ".bin", problems);
    }
    for (const name of Object.keys(LABEL_FOLDERS)) {
      const labels = numberedFiles(numbered.get(name) ?? new Map(), name, ".label", problems);
      if (labels) drive.labels[name] = labels;
    }
    if (kind === "scans" || kind === "pcd") borrowBeside(drive, folder, calibration);
    await readSmall(drive);
    if (kind === "pcd") drive.fields = await readFields(drive.recorded);
  }
  return drive;
}

/**
 * Say what each file is for.
 *
 * @param {DriveFolder} drive
 * @param {Map<string, File>} inside
 * @returns {Map<string, Map<string, File>>} Files of the folders of scans and labels, by their names.
 */
function sortFiles(drive, inside) {
  const { layout } = drive;
  const isReduced = layout === "reduced";
  const recorded = isRecordedLayout(layout) ? layout : null;
  const numbered = new Map([...SCAN_FOLDERS, ...Object.keys(LABEL_FOLDERS)].map((name) => [name, new Map()]));
  for (const [path, file] of inside) {
    const cut = path.lastIndexOf("/");
    const folder = numbered.get(path.slice(0, Math.max(0, cut)));
    if (isReduced && /^ground\/[^/]+\/\d+\.ground$/.test(path)) drive.ground.set(path, file);
    else if (recorded && isRecorded(path, recorded)) drive.recorded.set(path, file);
    else if (folder && !isReduced && /\.(bin|label)$/.test(path)) folder.set(path.slice(cut + 1), file);
    else if (!path.includes("/") && isMap(path)) drive.maps.set(path, file);
    else if ((isReduced && path === "reduced.json") || SMALL.some((pattern) => pattern.test(path)))
      drive.small.set(path, file);
    else if (recorded && isBeside(path, recorded)) drive.small.set(path, file);
    else if (isReduced && /\.(txt|csv|gz)$/.test(path)) drive.small.set(path, file);
    else {
      drive.unused.files += 1;
      drive.unused.bytes += file.size;
    }
  }
  return numbered;
}

/**
 * Take what the layouts keep beside the drive: calibration of the day (KITTI raw, KITTI-360), poses of KITTI odometry.
 *
 * @param {DriveFolder} drive
 * @param {import("./folder.js").Folder} folder
 * @param {string[]} calibration Paths of all calibration files in the folder.
 */
function borrowBeside(drive, folder, calibration) {
  const parts = drive.root ? drive.root.split("/") : [];
  /** @type {[string, string][]} */
  const wanted = []; // path in the folder, path in the drive
  for (const levels of [1, 2]) {
    if (parts.length < levels) break;
    const above = parts
      .slice(0, -levels)
      .map((part) => `${part}/`)
      .join("");
    for (const path of calibration) {
      const rest = path.startsWith(above) ? path.slice(above.length) : "";
      const isNear = levels === 1 && !rest.includes("/");
      if (rest && (isNear || /^calibration\/[^/]+$/.test(rest))) wanted.push([path, rest]);
    }
    wanted.push([`${above}poses/${drive.name}.txt`, "poses.txt"]);
    if (drive.scans?.folder === "velodyne_points/data") borrowPoses(drive, folder, above);
  }
  for (const [from, to] of wanted) {
    const file = folder.files.get(from);
    if (file && !drive.small.has(to) && !(to === "poses.txt" && drive.scans?.folder !== "velodyne")) {
      drive.small.set(to, file);
      drive.borrowed.push(from === to ? `${from} is taken with it.` : `${from} is taken as ${to}.`);
    }
  }
}

/**
 * Take the poses and OXTS that KITTI-360 keeps in folders of their own, beside that of the scans.
 *
 * @param {DriveFolder} drive
 * @param {import("./folder.js").Folder} folder
 * @param {string} above Path of the data set, with a slash at its end.
 */
function borrowPoses(drive, folder, above) {
  const target = `data_poses/${drive.name}/`;
  for (const source of [target, `data_poses_oxts/${drive.name}/`]) {
    let count = 0;
    for (const [path, file] of folder.files) {
      const rest = path.startsWith(above + source) ? path.slice(above.length + source.length) : "";
      if (!PUBLISHED_POSES.test(rest) || drive.small.has(target + rest)) continue;
      drive.small.set(target + rest, file);
      count += 1;
    }
    if (count) drive.borrowed.push(`${above}${source} is taken with it: ${plural(count, "file")}.`);
  }
}

/** @param {Map<string, File>} small Files of a drive. @returns {File | null} Its poses, as KITTI or KITTI-360 names them. */
export function posesOf(small) {
  const paths = [...small.keys()];
  const find = (/** @type {RegExp} */ name) => paths.find((path) => name.test(path));
  const path =
    find(/^poses\.txt$/) ?? find(/^cam0_to_world\.txt$/) ?? find(/^data_poses\/[^/]+\/(poses|cam0_to_world)\.txt$/);
  return (path && small.get(path)) || null;
}

/**
 * Find out what the small files of a drive tell of it, anew where some were added.
 *
 * @param {DriveFolder} drive
 */
export async function readSmall(drive) {
  drive.layout = await layoutOf(drive);
  const poses = drive.small.get("poses.txt");
  const wants = drive.layout === "semantickitti" && poses && !drive.small.has("calib.txt");
  drive.lacksCalibration = Boolean(wants && poses.size <= MAX_POSE_BYTES && areOfCamera(posesIn(await poses.text())));
}

/** @param {DriveFolder} drive @returns {Promise<DriveFolder["layout"]>} */
async function layoutOf(drive) {
  if (isRecordedLayout(drive.layout)) return drive.layout;
  const poses = posesOf(drive.small);
  if (poses) {
    const [line] = (await poses.slice(0, 4096).text()).split("\n", 1);
    if (INDEXED_LENGTHS.includes(line.split(/\s+/).filter(Boolean).length)) return "kitti360";
  }
  return drive.scans?.folder === "velodyne_points/data" ? "kitti_raw" : "semantickitti";
}

/**
 * @typedef {object} NumberedFiles
 * @property {string} folder Path inside the drive.
 * @property {string} suffix With its dot.
 * @property {number} digits Width that the numbers are padded to.
 * @property {Map<number, File>} files By number, ascending.
 * @property {number} bytes Of all of them.
 */

/**
 * Take the numbered files of one folder out of many.
 *
 * @param {Map<string, File>} files By name inside the folder.
 * @param {string} folder
 * @param {string} suffix
 * @param {FileProblem[]} problems Added to where a name is not that of a scan.
 * @returns {NumberedFiles | null} null where there is none.
 */
export function numberedFiles(files, folder, suffix, problems) {
  /** @type {[number, File, string][]} */
  const found = [];
  for (const [name, file] of files) {
    if (!name.endsWith(suffix)) continue;
    const stem = name.slice(0, -suffix.length);
    if (!/^\d{1,15}$/.test(stem)) {
      problems.push(error(`${folder}/${name}`, `is not named by its scan number. Expected names as 000000${suffix}.`));
      continue;
    }
    found.push([Number(stem), file, stem]);
  }
  if (!found.length) return null;
  found.sort((a, b) => a[0] - b[0]);
  const digits = found.reduce((min, [, , stem]) => Math.min(min, stem.length), Infinity);
  const odd = found.find(([number, , stem]) => stem !== String(number).padStart(digits, "0"));
  if (odd) {
    const text = `is numbered differently from its neighbours (${digits} digits). Usual cause: files of two drives in one folder.`;
    problems.push(error(`${folder}/${odd[2]}${suffix}`, text));
  }
  return {
    folder,
    suffix,
    digits,
    files: new Map(found.map(([number, file]) => [number, file])),
    bytes: found.reduce((sum, [, file]) => sum + file.size, 0),
  };
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

/** @param {number[]} numbers @param {number} [max] @returns {string} "3, 4, 5 and 12 more" */
function listed(numbers, max = 5) {
  const head = numbers.slice(0, max).join(", ");
  return numbers.length > max ? `${head} and ${formatCount(numbers.length - max)} more` : head;
}

/**
 * Some of many numbers, evenly spread from the first to the last: those that the service and `interloc info` look into.
 *
 * @param {number[]} numbers
 * @param {number} [count]
 */
export function sampleOf(numbers, count = 5) {
  if (numbers.length <= count) return numbers;
  return Array.from({ length: count }, (_, i) => numbers[roundEven((i * (numbers.length - 1)) / (count - 1))]);
}

/** @param {number} value @returns {number} Rounded as NumPy does: a half goes to the even number. */
function roundEven(value) {
  const floor = Math.floor(value);
  return value - floor === 0.5 ? floor + (floor % 2) : Math.round(value);
}

/** @param {string} path @param {string} message @returns {FileProblem} */
export const error = (path, message) => ({ severity: "error", path, message });
/** @param {string} path @param {string} message @returns {FileProblem} */
const note = (path, message) => ({ severity: "note", path, message });

const MAX_POSE_BYTES = 64e6;

/**
 * Estimate the number of keyframes from the poses of a drive.
 *
 * @param {DriveFolder} drive
 * @param {number} distance_m Between keyframes.
 * @returns {Promise<number | null>} null where only the service can read the poses.
 */
export async function estimateKeyframes({ small }, distance_m) {
  const file = posesOf(small) ?? small.get("poses.tum") ?? small.get("trajectory.tum");
  if (!file || file.size > MAX_POSE_BYTES) return null;
  const places = { 8: [1, 2, 3], 12: [3, 7, 11], 13: [4, 8, 12], 17: [4, 8, 12] }; // by numbers per line
  let count = 0;
  /** @type {number[] | null} */
  let last = null;
  for (const line of (await file.text()).split("\n")) {
    const numbers = line.trim().split(/\s+/).map(Number);
    const at = places[/** @type {keyof typeof places} */ (numbers.length)]?.map((i) => numbers[i]);
    if (!at?.every(Number.isFinite)) continue;
    if (last && Math.hypot(at[0] - last[0], at[1] - last[1], at[2] - last[2]) < distance_m) continue;
    last = at;
    count += 1;
  }
  return count || null;
}

const ORDER = ["error", "warning", "note"];

/** @param {FileProblem[]} problems @returns {FileProblem[]} Errors first. */
export function sorted(problems) {
  return [...problems].sort((a, b) => ORDER.indexOf(a.severity) - ORDER.indexOf(b.severity));
}

const MAX_SHOWN = 20;
const EXPECTED =
  "Expected the folder of one drive: velodyne/000000.bin, labels/000000.label, poses.txt, calib.txt (SemanticKITTI), " +
  "velodyne_points/data/ and oxts/ (KITTI raw), PCD files with poses.txt, a ROS bag (.bag, .db3, .mcap), or LAS or LAZ " +
  "files with their trajectory.";
const NO_LABELS =
  "There is neither labels/ nor predictions/. The method needs a road label for every point: any semantic " +
  "segmentation that writes SemanticKITTI .label files will do. Add the folder of its files below.";
const NO_NETWORKS =
  "Or let a network label the scans: with interloc label on your machine, or on this service as soon as whoever runs " +
  "it puts one there (INTERLOC_MODELS).";

/**
 * List what is wrong with, or worth knowing of, a drive, as far as names and sizes show.
 *
 * @param {DriveFolder} drive
 * @param {string[]} folders Label folders that are to be sent.
 * @param {boolean} hasOxts A georeference was given beside the drive.
 * @param {{model: string | null, canLabel: boolean}} [labelling] `model`: the network that labels the scans; `canLabel`:
 *   whether the service has any.
 * @returns {FileProblem[]} Errors first.
 */
export function checkDrive(drive, folders, hasOxts, { model, canLabel } = { model: null, canLabel: false }) {
  if (drive.layout === "reduced") {
    if (drive.ground.size) return [];
    return [error("ground", "holds no scan. Expected ground/labels/000000.ground and so on, as of interloc reduce.")];
  }
  const problems = [...drive.problems];
  if (isRecordedLayout(drive.layout)) {
    problems.push(...checkRecorded(drive, drive.layout, folders));
    if (drive.fields?.hasLabel === false && !Object.keys(drive.labels).length && !model) {
      problems.push(error(drive.fields.path, `has no label: ${wantsLabels(drive.fields, canLabel)}`));
    }
    return sorted([...problems, ...checkSmall(drive, hasOxts)]);
  }
  if (!drive.scans) {
    return [
      ...problems,
      error(drive.root || drive.name, "holds no scan (.bin). Expected velodyne/000000.bin and so on."),
    ];
  }
  if (!Object.keys(drive.labels).length && !model) {
    problems.push(error("labels", canLabel ? NO_LABELS : `${NO_LABELS} ${NO_NETWORKS}`));
  }
  for (const folder of folders) {
    if (drive.labels[folder]) problems.push(...checkLabels(drive.scans, drive.labels[folder]));
  }
  return sorted([...problems, ...checkSmall(drive, hasOxts)]);
}

/** @param {PcdFields} fields @param {boolean} canLabel @returns {string} */
function wantsLabels({ names }, canLabel) {
  const found = names.length ? `its fields are ${names.join(", ")}` : "it holds no named fields";
  const expected = `Expected one of ${getConfig().file_kinds.label_fields.join(", ")} among them, or labels/ with a .label file per scan; add that folder below.`;
  return `${found}. ${expected}${canLabel ? "" : ` ${NO_NETWORKS}`}`;
}

/**
 * @param {DriveFolder} drive
 * @param {import("./recordings.js").RecordedLayout} layout
 * @param {string[]} folders
 * @returns {FileProblem[]}
 */
function checkRecorded({ recorded, small, labels }, layout, folders) {
  const problems = atMost(
    recordingFaults(recorded, small, layout).map(([path, message]) => error(path, message)),
    "that cannot be sent",
  );
  for (const folder of layout === "pcd" ? folders : []) {
    const missing = recorded.size - (labels[folder]?.files.size ?? recorded.size);
    if (missing > 0) {
      const counts = `has no labels for ${formatCount(missing)} of ${plural(recorded.size, "scan")}`;
      problems.push(error(folder, `${counts}. Usual cause: an archive that was not unpacked to the end.`));
    }
  }
  return problems;
}

/** @param {FileProblem[]} problems @param {string} what @returns {FileProblem[]} The first, and how many more there are. */
function atMost(problems, what) {
  const more = problems.length - MAX_SHOWN;
  if (more <= 0) return problems;
  return [...problems.slice(0, MAX_SHOWN), error("files", `and ${plural(more, "more file")} ${what}.`)];
}

/** @param {NumberedFiles} scans @param {NumberedFiles} labels @returns {FileProblem[]} */
function checkLabels(scans, labels) {
  const problems = [];
  const { folder } = labels;
  const missing = [...scans.files.keys()].filter((number) => !labels.files.has(number));
  if (missing.length) {
    const counts = `${formatCount(missing.length)} of ${plural(scans.files.size, "scan")} have no labels`;
    const cause = "Usual cause: an archive that was not unpacked to the end.";
    problems.push(error(pathOf(labels, missing[0]), `is missing: ${counts} (${listed(missing)}). ${cause}`));
  }
  const extra = [...labels.files.keys()].filter((number) => !scans.files.has(number)).length;
  if (extra)
    problems.push(note(folder, `has labels of ${plural(extra, "scan")} not in the folder; they are not sent.`));
  const wrong = [];
  for (const [number, file] of scans.files) {
    const own = labels.files.get(number);
    const complaint = own && sizeComplaint(file.size, own.size, pathOf(scans, number), pathOf(labels, number));
    if (complaint) wrong.push(error(complaint.path, complaint.message));
  }
  return [...problems, ...atMost(wrong, "whose sizes do not fit")];
}

const NO_POSES = /** @type {Record<"pcd" | "las", [path: string, message: string]>} */ ({
  pcd: [
    "poses.txt",
    "is missing. Expected one pose of the LiDAR per scan: 12 numbers per line (KITTI), or TUM (poses.tum). Add the " +
      "file below.",
  ],
  las: [
    "trajectory",
    "is missing. Expected a file with where the LiDAR was, beside the points: a table with a header (time,x,y,z or " +
      "time,lat,lon,alt; .csv or .txt), SBET (.sbet, .out) or TUM. Add the file below.",
  ],
});

/** @param {DriveFolder} drive @param {boolean} hasOxts @returns {FileProblem[]} */
function checkSmall({ small, layout, lacksCalibration }, hasOxts) {
  if (layout === "rosbag") return []; // it holds poses and fixes itself
  const hasFolder = [...small.keys()].some((path) => /^(data_poses\/[^/]+\/)?oxts\//.test(path));
  const isPublished = layout === "kitti360" && [...small.keys()].some((path) => path.startsWith("data_poses/"));
  const problems = [];
  if (isRecordedLayout(layout)) {
    if (![...small.keys()].some((path) => mayBePoses(path, layout))) problems.push(error(...NO_POSES[layout]));
    if (layout === "las") return problems; // its coordinate system is the georeference
  }
  const hasPoses = isRecordedLayout(layout) || small.has("poses.txt") || (layout === "kitti360" && posesOf(small));
  if (!hasPoses && !(layout === "kitti_raw" && hasFolder)) {
    const text =
      "is missing. Expected one line of 12 numbers per scan: the pose of the camera (KITTI) or of the LiDAR (kiss-icp). " +
      `Add the file below${layout === "kitti_raw" ? "; of KITTI-360 pick its root, which has data_poses/ and calibration/" : ""}.`;
    problems.push(error("poses.txt", text));
  } else if (lacksCalibration) {
    const text = "is missing. It is needed because poses.txt holds poses of a camera, as those of KITTI do.";
    problems.push({ severity: "warning", path: "calib.txt", message: text });
  }
  if (!hasFolder && !isPublished && !small.has("geo.csv") && !hasOxts) {
    const text =
      "There is neither oxts/ nor geo.csv: place the drive on the map by its roads, or add a file of OXTS rows or a " +
      "geo.csv below. Otherwise the result is in local metres and cannot be scored against OpenStreetMap.";
    problems.push(note("georeference", text));
  }
  return problems;
}

/**
 * Say why there is no drive in a folder.
 *
 * @param {import("./folder.js").Folder} folder
 * @returns {string}
 */
export function noDriveReason({ name, files }) {
  const reasons = /** @type {[RegExp, string][]} */ ([
    [/^[^/]+\.bin$/, "holds the scans themselves: pick the folder above it"],
    [/^[^/]+\.label$/, "holds labels only: pick the folder above it"],
    [/\.(bag|db3|mcap)\.(zst|zstd|gz|lz4)$/i, "holds a bag that is compressed as a whole: unpack it first"],
    [/\.bag\.active$/, "holds a recording that was not ended properly: make a bag of it with rosbag reindex"],
    [/\.(zip|tar|tgz|tar\.\w+)$/i, "holds an archive: pick the archive itself, or unpack it first"],
    [
      /(^|\/)data_poses\/|^\d{4}_\d\d_\d\d_drive_\d{4}_sync\/(poses|cam0_to_world)\.txt$/,
      `holds poses but no scans: pick the root of KITTI-360, with data_3d_raw/ in it`,
    ],
    [/\.label$/, "holds labels but no scans: pick the folder that has velodyne/ too"],
  ]);
  const paths = [...files.keys()];
  const found = reasons.find(([pattern]) => paths.some((path) => pattern.test(path)));
  return `${name} ${found?.[1] ?? (paths.length ? "is not a drive" : "is empty")}. ${EXPECTED}`;
}

/**
 * Write the OXTS files of a KITTI raw drive as one file with one row per frame, the first for frame 0 of the sequence.
 *
 * @param {import("./folder.js").Folder} folder What was picked: the raw drive, or its oxts/.
 * @param {(done: number, total: number) => void} [onProgress]
 * @returns {Promise<File>}
 */
export async function oxtsRows(folder, onProgress = () => {}) {
  const found = [...folder.files].flatMap(([path, file]) => {
    const match = /^(?:(?:.*\/)?oxts\/)?(?:data\/)?(\d+)\.txt$/.exec(path);
    return match && !/(^|\/)(image_\d\d|velodyne_points)\//.test(path)
      ? [{ number: Number(match[1]), path, file }]
      : [];
  });
  const places = new Set(found.map(({ path }) => path.slice(0, path.lastIndexOf("/") + 1)));
  if (places.size > 1)
    throw new Error(
      `${folder.name} holds several OXTS folders (${[...places].slice(0, 3).join(", ")}): pick one drive.`,
    );
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
