/**
 * The drives of a picked folder, as the service sees them.
 *
 * Only the browser has the folder. It sends the names and sizes of its files, the contents of the small ones and how
 * often each label id occurs in some scans; the service answers which drive they are, what is wrong with it, where it
 * went and what is to be sent (`POST /drives/look`).
 */

import { getConfig, isMap, sendJson } from "../api.js";
import { countLabels } from "./reduce.js";

/** @import { FileProblem } from "../api.js" */
/** @import { Folder } from "./folder.js" */
/** @typedef {any} DriveLook What the service found in a drive, as its description of the API has it. */
/** @typedef {any} NumberedLook `LookedNumbers` there. */
/** @typedef {any} Track `LookedTrack` there. */
/** @typedef {[first: number, count: number][]} Runs Of numbers. */
/** @typedef {{root: string, name: string, kind: string, files: number}} ListedName */
/**
 * @typedef {object} DriveFolder
 * @property {Folder} folder What was picked.
 * @property {DriveLook} look
 * @property {Map<string, File>} whole Sent as they are, by path inside the drive: recordings, or ground points.
 * @property {Map<string, File>} small What else of it is sent: poses, calibration, times, OXTS.
 * @property {Map<string, File>} maps OSM files.
 * @property {{files: number, bytes: number}} unused What the method does not need, as pictures.
 */
/**
 * @typedef {object} Wish
 * @property {string} [root] The drive that is looked into; the first by default.
 * @property {object} [options] How it is read, as of the upload.
 * @property {{distance_m: number, angle_deg: number} | null} [keyframes] Scans that a job needs; null: all.
 * @property {Map<string, File>} [extras] Files from elsewhere, by their paths in the drive.
 */

const NEEDLESS = /\.(png|jpe?g|webp|tiff?|gif|mp4|avi|mkv)$/i;
const MAX_SMALL_BYTES = 8e6;
const MAX_CONTENT_BYTES = 23e6; // the service takes 32 MB, and Base64 makes a third more of them
const MAX_CONTENTS = 20_000;
const READ_AT_ONCE = 64;
const MAX_TURNS = 8; // of giving what the service asks for

/**
 * Let the service look into a folder, and give it what it asks for.
 *
 * @param {Folder} folder
 * @param {Wish} [wish]
 * @param {(json: object) => Promise<any>} [ask] Sends the request.
 * @returns {Promise<{drives: ListedName[], drive: DriveFolder | null, reason: string | null}>} `reason`: why there is no
 *   drive.
 */
export async function lookInto(folder, { root, options, keyframes, extras = new Map() } = {}, ask = askOnce) {
  const front = root ? `${root}/` : "";
  const files = new Map([...folder.files].filter(([path]) => !NEEDLESS.test(path)));
  for (const [path, file] of extras) files.set(front + path, file);
  const endings = getConfig().file_kinds.small;
  const isSmall = (/** @type {string} */ path) =>
    endings.some((end) => path.toLowerCase().replace(/\.gz$/, "").endsWith(end));
  const small = new Map([...files].filter(([path, { size }]) => isSmall(path) && size <= MAX_SMALL_BYTES));
  const request = {
    ...{ name: folder.name.slice(0, 200) || "drive", root, options, keyframes },
    files: Object.fromEntries([...files].map(([path, file]) => [path, file.size])),
    contents: await contentsOf(small),
    label_counts: /** @type {Record<string, Record<string, number>>} */ ({}),
  };

  /** Add to the request what the answer asks for. @param {DriveLook} look @returns {Promise<boolean>} Whether there was anything. */
  async function give(look) {
    const fileAt = (/** @type {string} */ path) => /** @type {File} */ (files.get(path));
    const heads = Object.entries(look.wanted).map(([path, bytes]) => [path, fileAt(path).slice(0, bytes)]);
    const more = await contentsOf(new Map(/** @type {[string, Blob][]} */ (heads)));
    Object.assign(request.contents, more);
    const uncounted = Object.entries(/** @type {Record<string, any>} */ (look.labels)).filter(
      ([name]) => !(name in request.label_counts),
    );
    for (const [name, labels] of uncounted) {
      const paths = look.frames_to_look_into.map((/** @type {number} */ frame) => pathOf(labels, frame));
      request.label_counts[name] = await countAll(folder, look.root, paths);
    }
    return Object.keys(more).length + uncounted.length > 0;
  }

  for (let turn = 1; ; turn += 1) {
    const answer = await ask(request);
    request.root = answer.drive?.root;
    if (answer.drive && turn < MAX_TURNS && (await give(answer.drive))) continue;
    return { ...answer, drive: answer.drive && driveOf(folder, answer.drive) };
  }
}

/** @param {object} json */
const askOnce = (json) => sendJson("POST", "drives/look", json);

/** @param {Folder} folder @param {string} root @param {string[]} paths Of label files in the drive. */
async function countAll(folder, root, paths) {
  /** @type {Record<string, number>} */
  const counts = {};
  for (const path of paths) {
    const file = folder.files.get(root ? `${root}/${path}` : path);
    if (!file) continue;
    for (const [id, count] of await countLabels(file, path)) counts[id] = (counts[id] ?? 0) + count;
  }
  return counts;
}

/**
 * @param {Map<string, Blob>} files
 * @returns {Promise<Record<string, string>>} Base64, by path; nothing where that is too much for one request.
 */
async function contentsOf(files) {
  /** @type {Record<string, string>} */
  const contents = {};
  const all = [...files];
  if (all.length > MAX_CONTENTS || bytesOf(files.values()) > MAX_CONTENT_BYTES) return contents;
  for (let i = 0; i < all.length; i += READ_AT_ONCE) {
    const part = all.slice(i, i + READ_AT_ONCE);
    const texts = await Promise.all(part.map(([, file]) => base64Of(file)));
    part.forEach(([path], row) => (contents[path] = texts[row]));
  }
  return contents;
}

/** @param {Blob} file */
async function base64Of(file) {
  const bytes = new Uint8Array(await file.arrayBuffer());
  let text = "";
  for (let i = 0; i < bytes.length; i += 8192) text += String.fromCharCode(...bytes.subarray(i, i + 8192));
  return btoa(text);
}

/** The files of a drive that the service has found in a folder. @param {Folder} folder @param {DriveLook} look */
export function driveOf(folder, look) {
  const front = look.root ? `${look.root}/` : "";
  const filesOf = (/** @type {Record<string, string>} */ paths) =>
    new Map(
      Object.entries(paths).flatMap(([inside, path]) => {
        const file = folder.files.get(path);
        return file ? [/** @type {[string, File]} */ ([inside, file])] : []; // else it is from elsewhere
      }),
    );
  const inside = [...folder.files].filter(([path]) => path.startsWith(front));
  const maps = inside.filter(([path]) => isMap(path) && !path.includes("/", front.length));
  /** @type {DriveFolder} */
  const drive = {
    ...{ folder, look, whole: filesOf(look.whole), small: filesOf(look.small), unused: { files: 0, bytes: 0 } },
    maps: new Map(maps.map(([path, file]) => [path.slice(front.length), file])),
  };
  const used = new Set([...drive.small, ...rawFiles(drive), ...drive.maps].map(([, file]) => file));
  const unused = inside.map(([, file]) => file).filter((file) => !used.has(file));
  drive.unused = { files: unused.length, bytes: bytesOf(unused) };
  return drive;
}

/** @param {DriveFolder} drive @param {string} inside @returns {string} A path of the drive in the folder that was picked. */
export const inFolder = ({ look }, inside) => (look.root ? `${look.root}/${inside}` : inside);

/** @param {NumberedLook} numbered @param {number} number @returns {string} Path inside the drive. */
export const pathOf = ({ folder, suffix, digits }, number) =>
  `${folder}/${String(number).padStart(digits, "0")}${suffix}`;

/** @param {Runs} runs @returns {number[]} */
export const numbersOf = (runs) => runs.flatMap(([first, count]) => Array.from({ length: count }, (_, i) => first + i));

/**
 * @param {DriveFolder} drive
 * @param {Map<string, File>} extras Files from elsewhere, by their paths in the drive.
 * @returns {Map<string, File>} The small files of the reduced drive, by their paths in it.
 */
export function plannedFiles(drive, extras) {
  const files = new Map(drive.folder.files);
  for (const [inside, file] of extras) files.set(inFolder(drive, inside), file);
  const planned = Object.entries(drive.look.plan?.files ?? {});
  return new Map(planned.map(([name, path]) => [name, /** @type {File} */ (files.get(path))]));
}

/** @param {DriveFolder} drive @param {NumberedLook} numbered @returns {[string, File][]} By path inside the drive. */
export function numberedFiles(drive, numbered) {
  return numbersOf(numbered.runs).flatMap((number) => {
    const path = pathOf(numbered, number);
    const file = drive.folder.files.get(inFolder(drive, path));
    return file ? [/** @type {[string, File]} */ ([path, file])] : [];
  });
}

/** @param {DriveFolder} drive @param {string[]} [folders] Of labels. @returns {[string, File][]} What is sent as it is. */
export function rawFiles(drive, folders = Object.keys(drive.look.labels)) {
  const kinds = [drive.look.scans, ...folders.map((name) => drive.look.labels[name])].filter(Boolean);
  return [...drive.whole, ...kinds.flatMap((kind) => numberedFiles(drive, /** @type {NumberedLook} */ (kind)))];
}

/** @param {Iterable<{size: number}>} files */
export const bytesOf = (files) => [...files].reduce((sum, file) => sum + file.size, 0);

const ORDER = ["error", "warning", "note"];

/** @param {FileProblem[]} problems @returns {FileProblem[]} Errors first. */
export function sorted(problems) {
  return [...problems].sort((a, b) => ORDER.indexOf(a.severity) - ORDER.indexOf(b.severity));
}

/**
 * What is wrong with, or worth knowing of, a drive.
 *
 * @param {DriveFolder} drive
 * @param {string[]} folders Label folders that are to be sent.
 * @param {boolean} isMade Whether the service makes the labels.
 * @returns {FileProblem[]} Errors first.
 */
export function problemsOf({ look }, folders, isMade) {
  const ofNone = isMade ? [] : look.unlabelled;
  const hasFolders = Object.keys(look.labels).length > 0;
  const ofLabels = hasFolders ? folders.flatMap((name) => look.labels[name]?.problems ?? []) : ofNone;
  const { georeference_reason: reason } = look;
  const message = `${reason}: place the drive on the map by its roads, or add a file of OXTS rows or a geo.csv below. Otherwise the result is in local metres and cannot be scored against OpenStreetMap.`;
  const note = reason && look.layout !== "reduced" ? [{ severity: "note", path: "georeference", message }] : [];
  return sorted([...look.problems, ...ofLabels, ...note]);
}
