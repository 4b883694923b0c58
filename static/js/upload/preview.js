/** What is to be sent, on the map before and while it is sent: its track, its scans, the roads of its map. */

import { getConfig } from "../api.js";
import { trackAlone } from "../data/results.js";
import { formatMetres, formatPercent, plural } from "../dom.js";
import { setPreview, shown } from "../map/shown.js";
import { isReadableMap } from "./osm_roads.js";

/** @import { DriveFolder, Track } from "./drive_folder.js" */
/** @import { MapLook } from "./osm_roads.js" */
/** @typedef {{track: Track | null, look: MapLook | null, isDone: boolean}} Found */

const ROAD_M = 15;

/** @type {Worker | null} */
let worker = null;
/** What is shown, so that it is not looked at again. */
let asked = "";
/** @type {Found | null} */
let last = null;
/** @type {(found: Found) => void} */
let listener = () => {};

/**
 * Show where a drive went, and what its map has there; anything that was looked at before is given up.
 *
 * @param {DriveFolder} drive
 * @param {File | null} map
 * @param {(found: Found) => void} onFound Called with the track, and again with what the map has there.
 */
export function showPreview(drive, map, onFound) {
  const { track } = drive.look;
  const key = JSON.stringify([drive.look.root, drive.look.name, track, map && [map.name, map.size, map.lastModified]]);
  listener = onFound;
  if (key === asked) {
    if (last) onFound(last);
    return;
  }
  dropWorker();
  asked = key;
  const show = (/** @type {Found} */ found) => {
    last = found;
    setPreview(track && previewOf(drive, found, map));
    listener(found);
  };
  const canLook = track && !track.local && map && isReadableMap(map.name) && typeof Worker === "function";
  show({ track, look: null, isDone: !canLook });
  if (!canLook) return;
  worker = new Worker(new URL("./worker.js", import.meta.url), { type: "module" });
  worker.addEventListener("message", ({ data: look }) => {
    worker?.terminate();
    show({ track, look, isDone: true });
  });
  worker.addEventListener("error", (event) => {
    event.preventDefault(); // there are no roads then, and that is all
    show({ track, look: null, isDone: true });
  });
  const { simulator, drivable } = getConfig();
  worker.postMessage({ positions: track.positions, map, words: { simulator, drivable } });
}

/** Show it no more. */
export function dropPreview() {
  dropWorker();
  setPreview(null);
}

/** @param {number} progress How much was sent, 0..1. */
export function setPreviewProgress(progress) {
  const { preview } = shown;
  if (preview && Math.floor(100 * progress) !== Math.floor(100 * preview.progress))
    setPreview({ ...preview, progress });
}

function dropWorker() {
  worker?.terminate();
  worker = null;
  last = null;
  asked = "";
}

/** @param {DriveFolder} drive @param {Found} found @param {File | null} map @returns {import("../map/shown.js").Preview} */
function previewOf(drive, { track, look }, map) {
  const { positions, local, length_m } = /** @type {Track} */ (track);
  const result = trackAlone(positions, local);
  result.keyframes = positions.map((/** @type {number[]} */ [lng, lat]) => ({ lng, lat, properties: {} }));
  result.roads = look?.roads ?? [];
  result.isMadeUp = look?.isMadeUp ?? false;
  const parts = [plural(positions.length, "scan"), formatMetres(length_m, 0)];
  if (local) parts.push("in metres of its poses: no georeference");
  if (look?.roads.length) parts.push(`roads of ${map?.name}`);
  return { result, title: drive.look.name, text: parts.join(" · "), progress: shown.preview?.progress ?? 0 };
}

/** Say how a map fits the drive. @param {File} map @param {Found} found @returns {[text: string, isBad: boolean]} */
export function mapVerdict(map, { track, look, isDone }) {
  if (!isReadableMap(map.name)) {
    return [`The service reads ${map.name}: this page looks into .osm and .osm.gz files only.`, false];
  }
  if (!track || track.local) return ["", false]; // where the drive was is not known yet
  if (!look)
    return [isDone ? `${map.name} could not be looked into: the service reads it.` : "Looking at the map …", false];
  const { covered, road_m, roads } = look;
  if (covered === 0) return [`${map.name} lies elsewhere: it covers nothing of the drive.`, true];
  const share = covered === 1 ? "100 %" : formatPercent(Math.min(covered, 0.999));
  const text = `The map covers ${share} of the distance driven`;
  if (road_m === null) return [`${text}, but has no road there.`, true];
  if (road_m > ROAD_M) {
    const far = `${text}, but its roads lie ${formatMetres(road_m, 0)} from the track (median)`;
    return [`${far}: is the georeference that of this drive?`, true];
  }
  const near = `${plural(roads.length, "road")} nearby, ${formatMetres(road_m, 1)} from the track (median)`;
  const lacking = covered < 1 ? " Intersections beyond the map count for nothing." : "";
  return [`${text}: ${near}.${lacking}`, covered < 0.9];
}
