/**
 * The choice of the map to score against: one that the drive has, a file of one's own, the map of today, or none.
 *
 * Nothing is chosen where the drive has no map: without a map a result has no score, so that has to be said, not left.
 */
import { getConfig, isMap } from "../api.js";
import { filePicker, radios } from "../controls.js";
import { el } from "../dom.js";

/** @typedef {{file: string} | {overpass: true} | {inside: true} | null} MapRequest `inside`: the map in an archive. */

/**
 * @param {object} known
 * @param {string[]} known.maps OSM files that the drive has, by path.
 * @param {boolean} [known.isArchive] What is in the drive is not known yet.
 * @param {{osm: MapRequest} | null} known.before What was chosen before.
 * @param {() => void} onChange
 */
export function mapChoice({ maps, isArchive = false, before }, onChange) {
  /** @type {File | null} */
  let ownFile = null;
  const endings = getConfig().file_kinds.maps;
  const ownName = el("span.small.quiet.cut", "None chosen yet");
  const pick = (/** @type {FileList} */ [file]) => {
    ownFile = isMap(file.name) ? file : null;
    ownName.textContent = ownFile ? file.name : `${file.name} is not an OSM file (${endings.join(", ")}).`;
    onChange();
  };
  const picker = filePicker("Choose a file …", pick, { accept: ".osm,.gz,.bz2,.pbf", name: "osm-file" });
  const own = el("div.row", picker, ownName);
  const inside = "If there is an .osm file in it; otherwise intersections are found but not scored.";
  const overpass = "From a public Overpass server, which learns where the drive is.";
  const choices = [
    ...maps.map((path) => ({ value: `file:${path}`, title: el("code", path), hint: "Among the files of the drive." })),
    ...(isArchive ? [{ value: "inside", title: "The map in the archive", hint: inside }] : []),
    { value: "other", title: "A file of mine", hint: endings.join(", "), more: own },
    ...(getConfig().overpass ? [{ value: "overpass", title: "Fetch the map of today", hint: overpass }] : []),
    { value: "none", title: "No map", hint: "Intersections are found but not scored." },
  ];
  const choice = radios("OpenStreetMap to score against", choices, usual(maps, isArchive, before), onChange);
  const verdict = el("p.small", { role: "status" });

  return {
    element: el("div.stack-s", choice.element, verdict),
    /** @returns {"file" | "overpass" | "none" | null} null: nothing is chosen yet. */
    kind: () => {
      const value = choice.value();
      if (value === "overpass" || value === "none") return value;
      return value ? "file" : null;
    },
    /** @returns {File | null} A map of one's own, to be sent as well. */
    ownFile: () => (choice.value() === "other" ? ownFile : null),
    /** What has to be chosen first, in words. @returns {string | null} */
    complaint: () => {
      if (!choice.value()) return "Choose the map to score against, or “No map”.";
      return choice.value() === "other" && !ownFile ? "Choose the OSM file, or another map." : null;
    },
    /** @returns {MapRequest} As a job is asked for it. */
    read: () => {
      const value = choice.value();
      if (value === "overpass") return { overpass: true };
      if (value === "inside") return { inside: true };
      if (value === "other" && ownFile) return { file: ownFile.name };
      return value.startsWith("file:") ? { file: value.slice("file:".length) } : null;
    },
    /** Tell how the chosen map fits the drive. @param {string} text @param {boolean} [isBad] */
    setVerdict: (text, isBad = false) => {
      verdict.textContent = text;
      verdict.className = isBad ? "note warning" : "small";
    },
  };
}

/** @param {string[]} maps @param {boolean} isArchive @param {{osm: MapRequest} | null} before */
function usual(maps, isArchive, before) {
  const osm = before?.osm;
  if (before && !osm) return "none";
  if (osm && "overpass" in osm) return "overpass";
  if (osm && "file" in osm && maps.includes(osm.file)) return `file:${osm.file}`;
  if (isArchive) return "inside";
  return maps.length ? `file:${maps[0]}` : "";
}
