/** What can be told of a drive before anything is sent. */

import { LABEL_FOLDERS } from "./drive_folder.js";
import { error, listed, note, pathOf, sorted, warning } from "./numbered.js";
import { sizeComplaint } from "./scan.js";

/** @typedef {import("./drive_folder.js").DriveFolder} DriveFolder */
/** @typedef {import("./numbered.js").FileProblem} FileProblem */

const MAX_SHOWN = 20;

/**
 * List what is wrong with, or worth knowing of, a drive, as far as names and sizes tell.
 *
 * @param {DriveFolder} drive
 * @param {string[]} folders Label folders that are to be sent.
 * @param {boolean} hasOxts A georeference was given beside the drive.
 * @returns {FileProblem[]} Errors first.
 */
export function checkDrive(drive, folders, hasOxts) {
  if (drive.layout === "reduced") return checkReduced(drive);
  const problems = [...drive.problems];
  if (!drive.scans) {
    problems.push(error(drive.root || drive.name, "holds no scan (.bin). Expected velodyne/000000.bin and on."));
    return problems;
  }
  if (!Object.keys(drive.labels).length) {
    problems.push(
      error(
        "labels",
        "There is neither labels/ nor predictions/. The method needs a road label for every point: any semantic " +
          "segmentation that writes SemanticKITTI .label files will do. Add the folder of its files below.",
      ),
    );
  }
  for (const folder of LABEL_FOLDERS) {
    if (folders.includes(folder) && drive.labels[folder]) problems.push(...checkLabels(drive, folder));
  }
  problems.push(...checkSmall(drive, hasOxts));
  return sorted(problems);
}

/** @param {DriveFolder} drive @param {string} folder @returns {FileProblem[]} */
function checkLabels(drive, folder) {
  const problems = [];
  const scans = /** @type {import("./numbered.js").NumberedFiles} */ (drive.scans);
  const labels = drive.labels[folder];
  const missing = [...scans.files.keys()].filter((number) => !labels.files.has(number));
  if (missing.length) {
    const counts = `${missing.length.toLocaleString("en")} of ${scans.files.size.toLocaleString("en")} scans have no labels`;
    const cause = "Usual cause: an archive that was not unpacked to the end.";
    problems.push(error(pathOf(labels, missing[0]), `is missing: ${counts} (${listed(missing)}). ${cause}`));
  }
  const extra = [...labels.files.keys()].filter((number) => !scans.files.has(number));
  if (extra.length) {
    problems.push(
      note(folder, `labels of ${extra.length.toLocaleString("en")} scans that are not there are not sent.`),
    );
  }
  const wrong = [];
  for (const [number, file] of scans.files) {
    const own = labels.files.get(number);
    const complaint = own && sizeComplaint(file.size, own.size, pathOf(scans, number), pathOf(labels, number));
    if (complaint) wrong.push(error(complaint.path, complaint.message));
  }
  problems.push(...wrong.slice(0, MAX_SHOWN));
  if (wrong.length > MAX_SHOWN) {
    problems.push(
      error(folder, `and ${(wrong.length - MAX_SHOWN).toLocaleString("en")} more files whose sizes do not fit.`),
    );
  }
  return problems;
}

/** @param {DriveFolder} drive @param {boolean} hasOxts @returns {FileProblem[]} */
function checkSmall(drive, hasOxts) {
  const { small, layout } = drive;
  const hasFolder = [...small.keys()].some((path) => path.startsWith("oxts/"));
  const problems = [];
  const hasPoses = small.has("poses.txt") || (layout === "kitti360" && small.has("cam0_to_world.txt"));
  if (!hasPoses && !(layout === "kitti_raw" && hasFolder)) {
    const message =
      "is missing. Expected one line of 12 numbers a scan: the pose of the camera (KITTI) or of the LiDAR (kiss-icp).";
    problems.push(error("poses.txt", `${message} Add the file below.`));
  } else if (layout === "semantickitti" && !small.has("calib.txt")) {
    problems.push(
      warning("calib.txt", "is missing. It is needed where poses.txt holds camera poses, as those of KITTI do."),
    );
  }
  if (!hasFolder && !small.has("geo.csv") && !hasOxts) {
    problems.push(
      note(
        "georeference",
        "There is neither oxts/ nor geo.csv: the result is in local metres, cannot be laid on a map, and cannot be scored " +
          "against OpenStreetMap. A file of OXTS rows or a geo.csv can be added below.",
      ),
    );
  }
  return problems;
}

/** @param {DriveFolder} drive @returns {FileProblem[]} */
function checkReduced(drive) {
  if (drive.ground.size) return [];
  return [
    error(
      "ground",
      "holds no scan. Expected ground/labels/000000.ground and on beside reduced.json, as interloc reduce writes them.",
    ),
  ];
}

/**
 * Say why a folder holds no drive.
 *
 * @param {import("./folder.js").Folder} folder
 * @returns {string}
 */
export function noDriveReason(folder) {
  const paths = [...folder.files.keys()];
  const expected =
    "Expected the folder of one drive: velodyne/000000.bin, labels/000000.label, poses.txt, calib.txt (SemanticKITTI), or velodyne_points/data/ and oxts/ (KITTI raw).";
  if (!paths.length) return `${folder.name} is empty. ${expected}`;
  const has = (/** @type {RegExp} */ pattern) => paths.some((path) => pattern.test(path));
  if (has(/^[^/]+\.bin$/)) return `${folder.name} holds the scans themselves: pick the folder above it. ${expected}`;
  if (has(/^[^/]+\.label$/)) return `${folder.name} holds labels only: pick the folder above it. ${expected}`;
  if (has(/\.(zip|tar|tgz|tar\.\w+)$/i))
    return `${folder.name} holds an archive: pick the archive itself, or unpack it first. ${expected}`;
  if (has(/\.label$/))
    return `${folder.name} holds labels but no scans: pick the folder that has velodyne/ too. ${expected}`;
  return `${folder.name} is not a drive. ${expected}`;
}
