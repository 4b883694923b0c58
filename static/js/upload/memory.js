/** Uploads that were begun, so that they can go on after a reload. */
import { keep, recall } from "../storage.js";

/**
 * @typedef {object} Remembered
 * @property {string} driveId
 * @property {string} fingerprint Of the files that were picked.
 * @property {string} name
 * @property {string} at When it was begun, ISO.
 * @property {import("./upload.js").Settings} settings
 * @property {string} [way] How all that was sent was made of these files; "" where files of other ways are among it.
 */

const KEY = "interloc.uploads";
const MAX_KEPT = 20;

/** @returns {Remembered[]} The latest first. */
export function rememberedUploads() {
  try {
    const list = JSON.parse(recall(KEY) ?? "[]");
    return Array.isArray(list) ? list : [];
  } catch {
    return []; // it was tampered with
  }
}

/** @param {Remembered[]} list */
function store(list) {
  keep(KEY, JSON.stringify(list.slice(0, MAX_KEPT)));
}

/** @param {string} driveId */
export const remembered = (driveId) => rememberedUploads().find((each) => each.driveId === driveId) ?? null;

/** @param {Remembered} upload */
export function remember(upload) {
  store([upload, ...rememberedUploads().filter((each) => each.driveId !== upload.driveId)]);
}

/** @param {string} driveId */
export function forget(driveId) {
  store(rememberedUploads().filter((each) => each.driveId !== driveId));
}

/**
 * Tell the files of a drive from those of another: by paths, sizes and times.
 *
 * @param {Iterable<[string, File]>} files
 */
export function fingerprintOf(files) {
  const lines = [...files].map(([path, file]) => `${path}|${file.size}|${file.lastModified}`).sort();
  let high = 0xdeadbeef; // two 32-bit hashes after cyrb53 (public domain); no secret depends on it
  let low = 0x41c6ce57;
  for (const line of lines) {
    for (let i = 0; i < line.length; i += 1) {
      const code = line.charCodeAt(i);
      high = Math.imul(high ^ code, 2654435761);
      low = Math.imul(low ^ code, 1597334677);
    }
  }
  return `${lines.length}-${(high >>> 0).toString(16)}${(low >>> 0).toString(16)}`;
}
