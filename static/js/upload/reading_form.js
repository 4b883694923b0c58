/** How the files of a drive are read: poses, layout, georeference from elsewhere, the topics of a bag. */

import { field, filePicker, radios, select } from "../controls.js";
import { el, fill, formatCount } from "../dom.js";
import { LAYOUTS, oxtsRows } from "./drive_folder.js";
import { folderOfInput } from "./folder.js";

/** @import { DriveFolder } from "./drive_folder.js" */

const POSE_FRAMES = {
  auto: "From the motion",
  camera: "Camera (KITTI, SemanticKITTI)",
  lidar: "LiDAR (kiss-icp and others)",
};
const FOUND = "Found by itself";

/**
 * @param {DriveFolder | null} drive null: an archive, of which nothing is known yet.
 * @param {import("./upload.js").Settings | null} before
 * @param {() => void} onChange
 */
export function readingForm(drive, before, onChange) {
  const georeference = georeferenceField(drive?.layout ?? null, onChange);
  const own = drive?.recorded.size ? drive.layout : null;
  const mayBe = (/** @type {string} */ layout) => drive === null || own === layout;
  const poseFrame = select(POSE_FRAMES, before?.options.pose_frame ?? "auto", onChange);
  const { reduced: _, ...layouts } = LAYOUTS;
  const layout = select({ auto: "From the folder", ...layouts }, before?.options.layout ?? "auto", onChange);
  const ofPoses = field("Poses are those of", poseFrame, "A wrong choice is noticed: the road would not be flat.");
  const grid = el("div.grid-2", own !== "rosbag" && own !== "las" && ofPoses, field("Layout", layout));

  const text = (/** @type {string | null | undefined} */ value, /** @type {string} */ placeholder) =>
    el("input", { type: "text", maxLength: 512, placeholder, value: value ?? "", onInput: onChange });
  const poses = before?.options.poses;
  const topics = {
    points: text(before?.options.points, FOUND),
    poses: text(poses?.startsWith("/") ? poses : "", FOUND),
    fix: text(before?.options.fix, FOUND),
  };
  const crs = text(before?.options.crs, "As the files name it");
  const part = text(before?.options.frames, "All of it");
  const poseFile = el("select", { onChange });
  const poseFileField = field("Poses are in", poseFile);
  const more = [
    mayBe("rosbag") && [
      el("div.field-name", drive ? "Topics of the bag" : "Topics, of a ROS bag"),
      el("div.grid-2", field("Scans", topics.points), field("Poses", topics.poses)),
      field("GNSS fixes", topics.fix, "As /velodyne_points, /odometry or /tf, /fix."),
    ],
    mayBe("las") && field("Coordinate system of LAS files", crs, "As EPSG:25832, where the files do not name it."),
    poseFileField,
    field("Part of the drive", part, "As 200:1400, by the numbers of its scans: 1400 is the first that is left out."),
  ];

  /** Offer the files that may hold the poses: they may come and go. */
  function setFiles() {
    const names = drive?.look?.pose_files ?? [];
    const wanted = poseFile.value || poses;
    fill(poseFile, el("option", { value: "" }, FOUND), ...names.map((path) => el("option", { value: path }, path)));
    poseFile.value = wanted && names.includes(wanted) ? wanted : "";
    poseFileField.hidden = names.length < 2;
  }
  setFiles();

  const textOf = (/** @type {HTMLInputElement} */ input) => input.value.trim() || null;
  function complaint() {
    const topic = Object.values(topics).find((input) => input.value.trim() && !input.value.trim().startsWith("/"));
    if (topic) return `The topic ${topic.value.trim()} does not begin with a slash.`;
    if (crs.value.trim() && !/^[A-Za-z]+:\d+$/.test(crs.value.trim())) {
      return "Write the coordinate system as EPSG:25832, or leave it empty.";
    }
    if (part.value.trim() && !/^\d{0,18}:\d{0,18}$/.test(part.value.trim())) {
      return "Write the part of the drive as 200:1400, or leave it empty.";
    }
    return georeference.complaint();
  }

  return {
    element: el("div.stack-s", georeference.element, grid, more),
    setFiles,
    read: () => ({
      pose_frame: poseFrame.value,
      layout: layout.value,
      points: textOf(topics.points),
      poses: textOf(topics.poses) ?? (poseFile.value || null),
      fix: textOf(topics.fix),
      crs: textOf(crs),
      frames: textOf(part),
    }),
    georeference: georeference.file,
    complaint,
  };
}

/** @param {DriveFolder["layout"] | null} layout @param {() => void} onChange */
function georeferenceField(layout, onChange) {
  /** @type {File | null} */
  let fix = null;
  const status = el("span.small.quiet", "None chosen yet");
  /** @param {Promise<File> | File} picked */
  async function take(picked) {
    fix = null;
    try {
      const file = await picked;
      if (!/\.(txt|csv)(\.gz)?$/i.test(file.name)) {
        throw new Error(`${file.name}: expected a file of OXTS rows (.txt, .txt.gz) or a geo.csv.`);
      }
      fix = file;
      status.textContent = file.name;
    } catch (error) {
      status.textContent = error instanceof Error ? error.message : String(error);
    }
    onChange();
  }
  const progress = (/** @type {number} */ done, /** @type {number} */ total) =>
    (status.textContent = `Reading ${formatCount(done)} of ${formatCount(total)} fixes`);
  const ofFile = { accept: ".txt,.csv,.gz", name: "georeference-file" };
  const asFile = filePicker("A file …", ([file]) => take(file), ofFile);
  const asFolder = filePicker("A KITTI raw drive …", (list) => take(oxtsRows(folderOfInput(list), progress)), {
    folder: true,
    name: "raw-drive",
  });
  const pickers = el("div.stack-s", el("div.row", asFile, asFolder), status);
  const inFolder = { title: "From the folder", hint: "oxts/ or geo.csv; without them, local metres only." };
  const inFiles = /** @type {Record<string, {title: string, hint: string}>} */ ({
    rosbag: { title: "From the bag", hint: "Its GNSS fixes; without them, local metres only." },
    las: { title: "From the files", hint: "Their coordinate system." },
  });
  const ofOthers = "One row of OXTS per frame, a geo.csv, or the KITTI raw drive of an odometry sequence.";
  const source = radios(
    "Georeference",
    [
      { value: "drive", ...(inFiles[layout ?? ""] ?? inFolder) },
      { value: "other", title: "From elsewhere", hint: ofOthers, more: pickers },
    ],
    "drive",
    onChange,
  );
  const isMissing = () => source.value() === "other" && !fix;
  return {
    element: source.element,
    file: () => (source.value() === "other" ? fix : null),
    /** @returns {string | null} */
    complaint: () => (isMissing() ? "Choose the georeference from elsewhere, or use that of the folder." : null),
  };
}
