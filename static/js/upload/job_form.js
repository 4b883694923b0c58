/** What is to be done with the drive: the map to score against, the labels to use, the settings of the method. */

import { el, fill } from "../dom.js";
import { getConfig } from "../shell/config.js";
import { field, filePicker, radios, section, select } from "./controls.js";
import { OSM_FILE } from "./drive_folder.js";
import { newKey } from "./job_request.js";
import { settingsForm } from "./settings_form.js";
import { LABEL_FOLDERS, POLICIES } from "./words.js";

/**
 * @param {object} known
 * @param {string[]} known.maps OSM files that the drive has, by path.
 * @param {boolean} known.isArchive What is in the drive is not known yet.
 * @param {string[]} known.folders Label folders.
 * @param {boolean} known.hasGeoreference
 * @param {any} known.presets As the service lists them.
 * @param {import("./job_request.js").JobSettings | null} known.before What was chosen before.
 * @param {() => void} onChange
 */
export function jobForm(known, onChange) {
  /** @type {File | null} */
  let otherMap = null;
  let { folders } = known;

  const otherName = el("span", { class: "small quiet cut" }, "None chosen yet");
  const mapPicker = filePicker(
    "Choose a file …",
    ([file]) => {
      otherMap = OSM_FILE.test(file.name) ? file : null;
      otherName.textContent = otherMap ? file.name : `${file.name} is no OSM file (.osm, .osm.gz, .osm.bz2, .osm.pbf).`;
      onChange();
    },
    { accept: ".osm,.gz,.bz2,.pbf", name: "osm-file" },
  );
  const choices = [
    ...known.maps.map((path) => ({ value: `file:${path}`, title: el("code", {}, path), hint: "In the folder." })),
    ...(known.isArchive
      ? [
          {
            value: "inside",
            title: "The map in the archive",
            hint: "If it holds an .osm file; else intersections are only found.",
          },
        ]
      : []),
    {
      value: "other",
      title: "A file of mine",
      hint: ".osm, .osm.gz, .osm.bz2 or .osm.pbf",
      more: el("div", { class: "row" }, mapPicker, otherName),
    },
    ...(getConfig().overpass
      ? [
          {
            value: "overpass",
            title: "Fetch the map of today",
            hint: "From a public Overpass server; tells it where the drive is.",
          },
        ]
      : []),
    { value: "none", title: "No map", hint: "Find intersections only." },
  ];
  const map = radios("OpenStreetMap to score against", choices, usualMap(known), () => (showPolicy(), onChange()));

  const policyHint = el("small", {});
  const tolerance = el("input", {
    type: "number",
    min: 1,
    max: 100,
    step: "any",
    required: true,
    value: known.before?.tolerance_m ?? 15,
  });
  const toleranceField = field("Merging reach [m]", tolerance);
  const policy = select(
    Object.fromEntries(Object.entries(POLICIES).map(([key, [title]]) => [key, title])),
    known.before?.policy ?? "drive",
    () => showPolicy(),
  );
  const policyField = el(
    "div",
    { class: "stack-s" },
    el("label", { class: "field" }, el("span", {}, "Which nodes count"), policy, policyHint),
    toleranceField,
  );
  function showPolicy() {
    policyField.hidden = map.value() === "none";
    policyHint.textContent = POLICIES[/** @type {keyof typeof POLICIES} */ (policy.value)][1];
    toleranceField.hidden = policy.value !== "consolidated";
  }

  const labels = el("select", { onChange });
  const labelsField = field("Labels to find intersections with", labels);
  /** @param {string[]} names */
  function setFolders(names) {
    folders = names;
    const before = labels.value || known.before?.labels;
    fill(
      labels,
      names.map((name) =>
        el("option", { value: name }, LABEL_FOLDERS[/** @type {keyof typeof LABEL_FOLDERS} */ (name)] ?? name),
      ),
    );
    if (before && names.includes(before)) labels.value = before;
    labelsField.hidden = names.length < 2;
  }

  const noFix = el(
    "p",
    { class: "note warning" },
    "Without a georeference nothing can be scored against a map: the job would refuse it.",
  );
  /** @param {boolean} has */
  function setGeoreference(has) {
    noFix.hidden = has || known.isArchive;
    if (!has && !known.isArchive && map.value() !== "none" && !known.before) map.choose("none");
    showPolicy();
  }

  const settings = settingsForm(known.presets, known.before, onChange);
  setFolders(folders);
  setGeoreference(known.hasGeoreference);
  const key = newKey();

  return {
    element: el(
      "div",
      { class: "stack" },
      section("Map", map.element, noFix, policyField),
      section("Method", labelsField, settings.element),
    ),
    setFolders,
    setGeoreference,
    /** What stands in the way, in words. @returns {string | null} */
    complaint: () => {
      if (map.value() === "other" && !otherMap) return "Choose the OSM file, or another map.";
      return settings.isValid() && tolerance.validity.valid ? null : "A setting is out of its range.";
    },
    keyframes: () => ({
      distance_m: settings.value("keyframes.distance_m"),
      angle_deg: settings.value("keyframes.angle_deg"),
    }),
    /** @returns {{job: import("./job_request.js").JobSettings, map: File | null}} `map`: to be sent as `osm.file`. */
    read: () => ({
      job: {
        ...settings.read(),
        labels: labels.value || null,
        osm: readMap(map.value(), otherMap),
        policy: policy.value,
        tolerance_m: Number(tolerance.value),
        key,
      },
      map: map.value() === "other" ? otherMap : null,
    }),
  };
}

/** @param {{maps: string[], isArchive: boolean, hasGeoreference: boolean, before: any}} known */
function usualMap({ maps, isArchive, hasGeoreference, before }) {
  if (before?.osm && "overpass" in before.osm) return "overpass";
  if (before?.osm && "file" in before.osm && maps.includes(before.osm.file)) return `file:${before.osm.file}`;
  if (isArchive) return "inside";
  return maps.length && hasGeoreference ? `file:${maps[0]}` : "none";
}

/** @param {string} value @param {File | null} other @returns {import("./job_request.js").JobSettings["osm"]} */
function readMap(value, other) {
  if (value === "overpass") return { overpass: true };
  if (value === "inside") return { inside: true };
  if (value === "other" && other) return { file: other.name };
  return value.startsWith("file:") ? { file: value.slice("file:".length) } : null;
}
