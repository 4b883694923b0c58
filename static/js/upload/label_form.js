/**
 * Where the labels of a drive come from: its label folders, its points, or the service, which makes them by geometry or by
 * a network.
 */

import { filePicker, radios, section } from "../controls.js";
import { LABEL_FOLDERS } from "../data/lists.js";
import { el, fill, formatBytes, formatCount, formatPercent, plural } from "../dom.js";

/** @import { DriveFolder } from "./drive_folder.js" */
/**
 * @typedef {object} Network As the service lists it.
 * @property {string} name
 * @property {number | null} size_bytes
 * @property {number | null} height Rows of its range image.
 * @property {number | null} width
 * @property {string | null} problem Why it cannot be used.
 */
/**
 * @typedef {object} MadeLabels Labels that the service makes.
 * @property {{labels: "geometry"} | {model: string}} options
 * @property {"geometry" | "predictions"} folder By which name jobs know them.
 * @property {string} why Why the service needs the scans themselves.
 */

const OF_NETWORK = "network:";
const BY_GEOMETRY = "geometry";
const OF_GEOMETRY = {
  value: BY_GEOMETRY,
  title: "By geometry, on the service",
  hint: "Needs no labels: the road is found by the points and the path driven. Labels of a good network place intersections better.",
};
const IN_FILES = {
  title: "With label files of mine",
  hint: "Of any segmentation that writes SemanticKITTI .label files.",
};
/** Labels that the browser cannot see: it does not read these files. By layout; "" is an archive. */
const UNSEEN = /** @type {Record<string, {title: string, hint: string}>} */ ({
  "": { title: "Those in the archive", hint: "labels/ or predictions/, or labels of the points themselves." },
  pcd: { title: "Labels of the points themselves", hint: "Their field label." },
  rosbag: {
    title: "Labels of the points themselves",
    hint: "The field label of their messages. Without one, the road is found by geometry.",
  },
  las: { title: "Classification of the points themselves", hint: "Class 11 is road surface (ASPRS)." },
});

/**
 * @param {object} known
 * @param {DriveFolder | null} known.drive null: an archive, of which nothing is known yet.
 * @param {Network[]} known.networks
 * @param {Partial<import("./upload.js").Settings> | null} known.before
 * @param {{onChange: () => void, onFolder: (files: FileList) => void}} listeners `onFolder`: labels from elsewhere.
 */
export function labelForm({ drive, networks, before }, { onChange, onFolder }) {
  const rows = el("div.stack-s");
  /** @type {Map<string, HTMLInputElement>} */
  const boxes = new Map();
  const meaning = el("small");
  const elsewhere = { folder: true, class: "link", name: "prediction-folder" };
  const picker = el("div", filePicker("Labels from another folder …", onFolder, elsewhere));

  const usable = networks.filter(({ problem }) => problem === null);
  const areSeen = drive && (drive.look.scans || drive.look.carries_labels === false); // label files, or none at all
  const unseen = areSeen ? null : UNSEEN[drive?.look.layout ?? ""];
  const ofNetworks = usable.map((network) => ({
    value: OF_NETWORK + network.name,
    title: ["By the network ", el("b", network.name), ", on the service"],
    hint: factsOf(network),
  }));
  const offers = [...ofNetworks, OF_GEOMETRY];
  const choices = unseen
    ? [{ value: "own", ...unseen }, ...offers]
    : [...offers, { value: "own", ...IN_FILES, more: picker }];
  const { model: modelBefore, labels: labelsBefore } = before?.options ?? {};
  const madeBefore = labelsBefore === BY_GEOMETRY ? BY_GEOMETRY : modelBefore ? OF_NETWORK + modelBefore : null;
  const wanted = madeBefore ?? (unseen || before ? "own" : "");
  const usual = choices.some(({ value }) => value === wanted) ? wanted : choices[0].value;
  const source = radios("Where labels come from", choices, usual, () => (show(), onChange()));
  const ofKeyframes = "The service labels the keyframes only, about one scan per two metres.";
  const chooser = [source.element, el("small", ofKeyframes)];
  const damaged = networks.filter(({ problem }) => problem !== null);
  const ofDamaged = damaged.map(({ name, problem }) => el("small", `The network ${name} cannot be used: ${problem}`));
  const offered = el("div.stack-s", chooser, ofDamaged);

  // Of a bag or of LAS files only the service knows which scans there are; labels that lie beside are sent all the same.
  const hasPlace = unseen && drive?.look.layout === "pcd";
  const hasFolders = () => boxes.size > 0;
  /** @returns {MadeLabels | null} */
  function made() {
    const chosen = source.value();
    if (hasFolders() || chosen === "own") return null;
    const why = "The service makes the labels, so the scans are sent whole";
    if (chosen === BY_GEOMETRY) return { options: { labels: BY_GEOMETRY }, folder: BY_GEOMETRY, why };
    return { options: { model: chosen.slice(OF_NETWORK.length) }, folder: "predictions", why };
  }
  function show() {
    offered.hidden = hasFolders();
    meaning.hidden = made() !== null;
  }

  show();

  return {
    element: section("Labels", drive && rows, offered, hasPlace && picker, meaning),
    /** @param {import("./drive_folder.js").DriveLook["labels"]} folders */
    setFolders(folders) {
      const texts = Object.entries(folders).flatMap(([folder, { scheme: name, road_share }]) =>
        name ? `${folder}: read as ${name === "custom" ? "given" : name}, ${formatPercent(road_share)} road.` : [],
      );
      meaning.textContent = texts.join(" ");
      const names = Object.keys(folders);
      const wasOff = new Set([...boxes].filter(([, box]) => !box.checked).map(([name]) => name));
      boxes.clear();
      const items = names.map((name) => {
        const isOn = before?.folders ? before.folders.includes(name) || !boxes.size : !wasOff.has(name);
        const isOnly = names.length === 1;
        const box = el("input", { type: "checkbox", checked: isOn || isOnly, disabled: isOnly, onChange });
        boxes.set(name, box);
        const count = plural(folders[name].count, "file");
        if (isOnly) return el("p", `${LABEL_FOLDERS[name]}, ${count}`);
        return el("label.check", box, el("span", LABEL_FOLDERS[name], el("small", count)));
      });
      fill(rows, items, !names.length && !unseen && el("p.quiet", "None in the folder."));
      rows.hidden = !rows.childElementCount;
      if (hasFolders() && !unseen) rows.append(picker);
      show();
    },

    folders: () => [...boxes].filter(([, box]) => box.checked).map(([name]) => name),
    /** The labels that the service makes; null: the drive has labels. */
    made,
  };
}

/** @param {Network} network */
function factsOf({ size_bytes, height, width }) {
  const facts = [
    size_bytes !== null && formatBytes(size_bytes),
    height && width && `range image of ${formatCount(height)} × ${formatCount(width)}`,
  ];
  return facts.filter(Boolean).join(", ");
}
