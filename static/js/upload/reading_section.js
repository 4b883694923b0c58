/** The part of the form about how the files are read: poses, layout, georeference from elsewhere. */

import { el, formatCount } from "../dom.js";
import { field, filePicker, radios, select } from "./controls.js";
import { folderOfInput } from "./folder.js";
import { georeferenceComplaint, oxtsRows } from "./oxts_rows.js";
import { LAYOUTS, POSE_FRAMES } from "./words.js";

/**
 * @param {import("./upload.js").Settings | null} before
 * @param {() => void} onChange
 */
export function readingSection(before, onChange) {
  /** @type {File | null} */
  let fix = null;
  const said = el("span", { class: "small quiet" }, "None chosen yet");
  /** @param {Promise<File> | File} picked */
  async function take(picked) {
    fix = null;
    try {
      fix = await picked;
      const complaint = georeferenceComplaint(fix);
      if (complaint) throw new Error(complaint);
      said.textContent = fix.name;
    } catch (error) {
      fix = null;
      said.textContent = error instanceof Error ? error.message : String(error);
    }
    onChange();
  }
  const progress = (/** @type {number} */ done, /** @type {number} */ total) =>
    (said.textContent = `Reading ${formatCount(done)} of ${formatCount(total)} fixes`);
  const pickers = el(
    "div",
    { class: "stack-s" },
    el(
      "div",
      { class: "row" },
      filePicker("A file …", ([file]) => take(file), { accept: ".txt,.csv,.gz", name: "georeference-file" }),
      filePicker("A KITTI raw drive …", (list) => take(oxtsRows(folderOfInput(list), progress)), {
        folder: true,
        name: "raw-drive",
      }),
    ),
    said,
  );
  const source = radios(
    "Where it was on Earth",
    [
      { value: "drive", title: "What the folder says", hint: "oxts/ or geo.csv; without them, local metres only." },
      {
        value: "other",
        title: "From elsewhere",
        hint: "A row of OXTS a frame, a geo.csv, or the KITTI raw drive of an odometry sequence.",
        more: pickers,
      },
    ],
    "drive",
    onChange,
  );
  const poseFrame = select(POSE_FRAMES, before?.options.pose_frame ?? "auto", onChange);
  const { reduced: _, ...layouts } = LAYOUTS;
  const layout = select({ auto: "Tell by the folder", ...layouts }, before?.options.layout ?? "auto", onChange);

  return {
    element: el(
      "div",
      { class: "stack-s" },
      source.element,
      el(
        "div",
        { class: "grid-2" },
        field("Poses are those of", poseFrame, "A wrong choice is noticed: the road would not be flat."),
        field("Layout", layout),
      ),
    ),
    read: () => ({ pose_frame: poseFrame.value, layout: layout.value }),
    georeference: () => (source.value() === "other" ? fix : null),
    /** @returns {string | null} */
    complaint: () =>
      source.value() === "other" && !fix
        ? "Choose the georeference from elsewhere, or take what the folder says."
        : null,
  };
}
