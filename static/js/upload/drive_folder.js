/**
 * Which drives a picked folder holds, which of its files belong to them, and what is wrong by their names and sizes.
 *
 * Only the browser sees the folder, so what is missing or cut short is reported here, before anything is sent. The
 * service judges all that has to be read: poses, georeference, labels, calibration.
 */

import { getConfig, isMap } from "../api.js";
import { formatCount, plural } from "../dom.js";
import { sizeComplaint } from "./reduce.js";

/** @typedef {import("../api.js").FileProblem} FileProblem */

/**
 * @typedef {object} DriveFolder
 * @property {string} name
 * @property {string} root Its path inside what was picked; "" where it is the folder itself.
 * @property {"semantickitti" | "kitti_raw" | "kitti360" | "reduced"} layout
 * @property {NumberedFiles | null} scans null of a reduced drive.
 * @property {Record<string, NumberedFiles>} labels By folder: labels, predictions.
 * @property {Map<string, File>} small What else of it is sent, by path inside the drive: poses, calibration, times, OXTS.
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
  reduced: "reduced drive",
};
const SCAN_FOLDERS = ["velodyne", "velodyne_points/data"];
export const LABEL_FOLDERS = /** @type {Record<string, string>} */ ({
  labels: "labels (by hand)",
  predictions: "predictions (of a network)",
});
const SMALL = [
  /^(poses|cam0_to_world|times|timestamps)\.txt$/,
  /^calib[^/]*\.txt$/,
  /^calibration\/[^/]+\.txt$/,
  /^geo\.csv$/,
  /^oxts\/([^/]+\/)?[^/]+\.txt(\.gz)?$/,
  /^velodyne_points\/timestamps[^/]*\.txt$/,
];
const INDEXED_LENGTHS = [13, 17]; // numbers per pose line that starts with its frame

/**
 * Find the drives in a folder: in itself, or in folders below it.
 *
 * @param {import("./folder.js").Folder} folder
 * @returns {Promise<DriveFolder[]>} In the order of their paths.
 */
export async function findDrives(folder) {
  const roots = new Map();
  for (const path of folder.files.keys()) {
    const match = /^(?:(.*)\/)?(?:(velodyne|velodyne_points\/data)\/[^/]+\.bin|(reduced\.json))$/.exec(path);
    if (match) {
      const root = match[1] ?? "";
      roots.set(root, roots.get(root) || Boolean(match[3]));
    }
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
    sorted.map(([root, isReduced]) =>
      readDrive({ folder, root, inside: byRoot.get(root) ?? new Map(), isReduced, calibration }),
    ),
  );
}

/**
 * @param {{folder: import("./folder.js").Folder, root: string, inside: Map<string, File>, isReduced: boolean,
 *   calibration: string[]}} found `inside`: its files by path inside it; `calibration`: paths of all such files.
 * @returns {Promise<DriveFolder>}
 */
async function readDrive({ folder, root, inside, isReduced, calibration }) {
  /** @type {FileProblem[]} */
  const problems = [];
  /** @type {DriveFolder} */
  const drive = {
    name: root ? /** @type {string} */ (root.split("/").pop()) : folder.name,
    root,
    layout: isReduced ? "reduced" : "semantickitti",
    scans: null,
    labels: {},
    small: new Map(),
    maps: new Map(),
    ground: new Map(),
    borrowed: [],
    unused: { files: 0, bytes: 0 },
    problems,
  };
  const numbered = sortFiles(drive, inside, isReduced);
  if (!isReduced) {
    for (const name of SCAN_FOLDERS) {
      drive.scans ??= numberedFiles(numbered.get(name) ?? new Map(), name, ".bin", problems);
    }
    for (const name of Object.keys(LABEL_FOLDERS)) {
      const labels = numberedFiles(numbered.get(name) ?? new Map(), name, ".label", problems);
      if (labels) drive.labels[name] = labels;
    }
    borrowBeside(drive, folder, calibration);
    drive.layout = await layoutOf(drive);
  }
  return drive;
}

/**
 * Say what each file is for.
 *
 * @param {DriveFolder} drive
 * @param {Map<string, File>} inside
 * @param {boolean} isReduced
 * @returns {Map<string, Map<string, File>>} Files of the folders of scans and labels, by their names.
 */
function sortFiles(drive, inside, isReduced) {
  const numbered = new Map([...SCAN_FOLDERS, ...Object.keys(LABEL_FOLDERS)].map((name) => [name, new Map()]));
  for (const [path, file] of inside) {
    const cut = path.lastIndexOf("/");
    const folder = numbered.get(path.slice(0, Math.max(0, cut)));
    if (isReduced && /^ground\/[^/]+\/\d+\.ground$/.test(path)) drive.ground.set(path, file);
    else if (folder && !isReduced && /\.(bin|label)$/.test(path)) folder.set(path.slice(cut + 1), file);
    else if (!path.includes("/") && isMap(path)) drive.maps.set(path, file);
    else if ((isReduced && path === "reduced.json") || SMALL.some((pattern) => pattern.test(path)))
      drive.small.set(path, file);
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
  }
  for (const [from, to] of wanted) {
    const file = folder.files.get(from);
    if (file && !drive.small.has(to) && !(to === "poses.txt" && drive.scans?.folder !== "velodyne")) {
      drive.small.set(to, file);
      drive.borrowed.push(`${from} is taken as ${to}.`);
    }
  }
}

/** @param {DriveFolder} drive @returns {Promise<DriveFolder["layout"]>} */
export async function layoutOf(drive) {
  const poses = drive.small.get("poses.txt") ?? drive.small.get("cam0_to_world.txt");
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
 * Some of many numbers, evenly spread from the first to the last.
 *
 * @param {number[]} numbers
 * @param {number} [count]
 */
export function sampleOf(numbers, count = 5) {
  if (numbers.length <= count) return numbers;
  return Array.from({ length: count }, (_, i) => numbers[Math.round((i * (numbers.length - 1)) / (count - 1))]);
}

/** @param {string} path @param {string} message @returns {FileProblem} */
export const error = (path, message) => ({ severity: "error", path, message });
/** @param {string} path @param {string} message @returns {FileProblem} */
const note = (path, message) => ({ severity: "note", path, message });

const ORDER = ["error", "warning", "note"];

/** @param {FileProblem[]} problems @returns {FileProblem[]} Errors first. */
export function sorted(problems) {
  return [...problems].sort((a, b) => ORDER.indexOf(a.severity) - ORDER.indexOf(b.severity));
}

const MAX_SHOWN = 20;
const EXPECTED =
  "Expected the folder of one drive: velodyne/000000.bin, labels/000000.label, poses.txt, calib.txt (SemanticKITTI), " +
  "or velodyne_points/data/ and oxts/ (KITTI raw).";

/**
 * List what is wrong with, or worth knowing of, a drive, as far as names and sizes show.
 *
 * @param {DriveFolder} drive
 * @param {string[]} folders Label folders that are to be sent.
 * @param {boolean} hasOxts A georeference was given beside the drive.
 * @returns {FileProblem[]} Errors first.
 */
export function checkDrive(drive, folders, hasOxts) {
  if (drive.layout === "reduced") {
    if (drive.ground.size) return [];
    return [error("ground", "holds no scan. Expected ground/labels/000000.ground and so on, as of interloc reduce.")];
  }
  const problems = [...drive.problems];
  if (!drive.scans) {
    return [
      ...problems,
      error(drive.root || drive.name, "holds no scan (.bin). Expected velodyne/000000.bin and so on."),
    ];
  }
  if (!Object.keys(drive.labels).length) {
    const text =
      "There is neither labels/ nor predictions/. The method needs a road label for every point: any semantic " +
      "segmentation that writes SemanticKITTI .label files will do. Add the folder of its files below.";
    problems.push(error("labels", text));
  }
  for (const folder of folders) {
    if (drive.labels[folder]) problems.push(...checkLabels(drive.scans, drive.labels[folder]));
  }
  return sorted([...problems, ...checkSmall(drive, hasOxts)]);
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
  const more = wrong.length - MAX_SHOWN;
  if (more > 0)
    wrong.splice(MAX_SHOWN, more, error(folder, `and ${plural(more, "more file")} whose sizes do not fit.`));
  return [...problems, ...wrong];
}

/** @param {DriveFolder} drive @param {boolean} hasOxts @returns {FileProblem[]} */
function checkSmall({ small, layout }, hasOxts) {
  const hasFolder = [...small.keys()].some((path) => path.startsWith("oxts/"));
  const problems = [];
  const hasPoses = small.has("poses.txt") || (layout === "kitti360" && small.has("cam0_to_world.txt"));
  if (!hasPoses && !(layout === "kitti_raw" && hasFolder)) {
    const text =
      "is missing. Expected one line of 12 numbers per scan: the pose of the camera (KITTI) or of the LiDAR (kiss-icp). " +
      "Add the file below.";
    problems.push(error("poses.txt", text));
  } else if (layout === "semantickitti" && !small.has("calib.txt")) {
    const text = "is missing. It is needed where poses.txt holds camera poses, as those of KITTI do.";
    problems.push({ severity: "warning", path: "calib.txt", message: text });
  }
  if (!hasFolder && !small.has("geo.csv") && !hasOxts) {
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
    [/\.(zip|tar|tgz|tar\.\w+)$/i, "holds an archive: pick the archive itself, or unpack it first"],
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
