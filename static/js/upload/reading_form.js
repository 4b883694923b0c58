/** How the files of a drive are read: the options of reading, by their schema, and a georeference from elsewhere. */

import { getConfig } from "../api.js";
import { field, filePicker, OPTIONS, schemaInput } from "../controls.js";
import { el, fill, plural } from "../dom.js";
import { folderOfInput } from "./folder.js";

/** @import { DriveFolder } from "./drive_folder.js" */
/** @typedef {{path: string, files: Map<string, File>}} Georeference From elsewhere: its path in the drive, and its files. */

const PLACE = "georeference";

const ONLY_OF = /** @type {Record<string, string>} */ ({ points: "rosbag", fix: "rosbag", crs: "las" });
const POSE_FRAMES = {
  auto: "From the motion",
  camera: "Camera (KITTI, SemanticKITTI)",
  lidar: "LiDAR (kiss-icp and others)",
};
const DESKEW = { auto: "Taken out where the points show it", on: "Taken out", off: "Left as it is" };

/**
 * @param {DriveFolder | null} drive null: an archive, of which nothing is known yet.
 * @param {Partial<import("./upload.js").Settings> | null} before
 * @param {() => void} onChange
 */
export function readingForm(drive, before, onChange) {
  const { reading_schema, layouts, label_schemes } = getConfig();
  const own = drive?.look.layout ?? null;
  const georeference = georeferenceField(onChange);
  const { reduced: _, ...ofLayout } = layouts;
  const choices = /** @type {Record<string, Record<string, string>>} */ ({
    ...{ pose_frame: POSE_FRAMES, deskew: DESKEW, layout: { auto: "From the folder", ...ofLayout } },
  });
  const poseFiles = el("datalist", { id: "pose-files" });
  const schemes = el("datalist", { id: "label-schemes" }, [
    label_schemes.map(({ name, title, road }) => el("option", { value: name }, `${title} (road = ${road.join(", ")})`)),
  ]);

  /** @param {string} name */
  function optionOf(name) {
    const schema = reading_schema.properties[name];
    let given = before?.options?.[name] ?? schema.default ?? null;
    const take = (/** @type {any} */ next) => ((given = next), onChange());
    const input = schemaInput(schema, given, take, (choice) => choices[name]?.[choice] ?? choice);
    if (name === "poses") input.setAttribute("list", poseFiles.id);
    if (name === "label_scheme") input.setAttribute("list", schemes.id);
    if (ONLY_OF[name] === "rosbag") input.pattern = "/.*";
    const complaint = `${OPTIONS[name]}: write it as ${schema.examples?.[0]}, or leave it empty.`;
    return {
      name,
      read: () => given ?? schema.default,
      element: field(OPTIONS[name], input, schema.description),
      /** @returns {string | null} */
      complaint: () => (input.validity.valid ? null : complaint),
    };
  }

  const isApt = (/** @type {string} */ name) => !drive || !ONLY_OF[name] || ONLY_OF[name] === own;
  const options = Object.keys(OPTIONS)
    .filter((name) => name in reading_schema.properties && isApt(name))
    .map(optionOf);

  /** Offer the files that may hold the poses: they may come and go. */
  function setFiles() {
    fill(
      poseFiles,
      (drive?.look.pose_files ?? []).map((/** @type {string} */ path) => el("option", { value: path })),
    );
  }
  setFiles();

  return {
    element: el(
      "div.stack-s",
      georeference.element,
      options.map(({ element }) => element),
      poseFiles,
      schemes,
    ),
    setFiles,
    /** @returns {Record<string, string | null>} */
    read: () => Object.fromEntries(options.map(({ name, read }) => [name, read()])),
    georeference: georeference.file,
    /** @returns {string | null} */
    complaint: () => options.map(({ complaint }) => complaint()).find(Boolean) ?? null,
  };
}

/** @param {() => void} onChange */
function georeferenceField(onChange) {
  /** @type {Georeference | null} */
  let fix = null;
  const status = el("span.small.quiet", { role: "status" });
  /** @param {string} name @param {[string, File][]} files By path; none: it is no georeference. @param {string} text */
  function take(name, files, text) {
    fix = files.length ? { path: `${PLACE}/${name}`, files: new Map(files) } : null;
    status.textContent = text;
    onChange();
  }
  const takeFile = (/** @type {FileList} */ [file]) => {
    const isGood = /\.(txt|csv)(\.gz)?$/i.test(file.name);
    const text = isGood ? file.name : `${file.name}: expected a file of OXTS rows (.txt, .txt.gz) or a geo.csv.`;
    take(file.name, isGood ? [[`${PLACE}/${file.name}`, file]] : [], text);
  };
  const takeFolder = (/** @type {FileList} */ list) => {
    const { name, files } = folderOfInput(list);
    const texts = [...files].filter(
      ([inside]) => /\.txt$/.test(inside) && !/(^|\/)(image_\d\d|velodyne_points)\//.test(inside),
    );
    const text = `${name}: ${texts.length ? plural(texts.length, "file") : "no OXTS file is in it"}.`;
    const named = texts.map(([inside, file]) => /** @type {[string, File]} */ ([`${PLACE}/${name}/${inside}`, file]));
    take(name, named, text);
  };
  const ofFile = { accept: ".txt,.csv,.gz", name: "georeference-file" };
  const pickers = el("div.row", [
    filePicker("A file …", takeFile, ofFile),
    filePicker("A KITTI raw drive …", takeFolder, { folder: true, name: "raw-drive" }),
    status,
  ]);
  const hint = "One row of OXTS per frame, a geo.csv, or the KITTI raw drive of an odometry sequence.";
  const title = el("span.field-name", "Georeference from elsewhere");
  return { element: el("div", title, pickers, el("small", hint)), file: () => fix };
}
