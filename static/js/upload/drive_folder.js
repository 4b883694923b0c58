/** Which drives a folder holds, and which of its files belong to them. */

import { numberedFiles } from "./numbered.js";

/** @typedef {import("./numbered.js").NumberedFiles} NumberedFiles */
/** @typedef {import("./numbered.js").FileProblem} FileProblem */

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

export const LABEL_FOLDERS = ["labels", "predictions"];
export const OSM_FILE = /\.osm(\.gz|\.bz2|\.pbf)?$|\.pbf$/i;

const SCAN_FOLDERS = ["velodyne", "velodyne_points/data"];
const SMALL = [
  /^(poses|cam0_to_world|times|timestamps)\.txt$/,
  /^calib[^/]*\.txt$/,
  /^calibration\/[^/]+\.txt$/,
  /^geo\.csv$/,
  /^oxts\/([^/]+\/)?[^/]+\.txt(\.gz)?$/,
  /^velodyne_points\/timestamps[^/]*\.txt$/,
];
const INDEXED_LENGTHS = [13, 17]; // numbers a pose line that starts with its frame

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
    for (const name of LABEL_FOLDERS) {
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
  const numbered = new Map([...SCAN_FOLDERS, ...LABEL_FOLDERS].map((name) => [name, new Map()]));
  for (const [path, file] of inside) {
    const cut = path.lastIndexOf("/");
    const folder = numbered.get(path.slice(0, Math.max(0, cut)));
    if (isReduced && /^ground\/[^/]+\/\d+\.ground$/.test(path)) drive.ground.set(path, file);
    else if (folder && !isReduced && /\.(bin|label)$/.test(path)) folder.set(path.slice(cut + 1), file);
    else if (!path.includes("/") && OSM_FILE.test(path)) drive.maps.set(path, file);
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
