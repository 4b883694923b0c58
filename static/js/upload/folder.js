/** Files of a folder that was picked or dropped, by their paths inside it. */

import { isArchive } from "../api.js";

/**
 * @typedef {object} Folder
 * @property {string} name
 * @property {Map<string, File>} files By path inside the folder, parts joined by "/".
 */

/** @typedef {(count: number) => void} OnCount Called now and then with the number of files found. */

const JUNK = /(^|\/)(\.[^/]*|__MACOSX|Thumbs\.db|desktop\.ini)(\/|$)/i;
const STILL_MS = 24;

/**
 * The folder of `<input type="file" webkitdirectory>`; files that were picked by themselves are one, too.
 *
 * @param {FileList} list
 * @returns {Folder}
 */
export function folderOfInput(list) {
  const files = new Map();
  let name = nameOfFiles([...list]);
  for (const file of list) {
    const [top, ...rest] = (file.webkitRelativePath || file.name).split("/");
    name = rest.length ? top : name;
    put(files, rest.length ? rest.join("/") : top, file);
  }
  return { name, files };
}

/** @param {File[]} files @returns {string} The name of the largest, without its ending: that of a drive in loose files. */
function nameOfFiles(files) {
  const largest = files.reduce((/** @type {File | null} */ a, b) => (a && a.size >= b.size ? a : b), null);
  return largest?.name.replace(/(\.[A-Za-z]\w*)+$/, "") || "drive";
}

/**
 * Ask for the sizes of all files, a few at a time: browsers look at the disk at the first question and stand still
 * meanwhile, for seconds where there are thousands.
 *
 * @param {Folder} folder
 * @param {OnCount} [onCount]
 */
export async function measure(folder, onCount = () => {}) {
  let count = 0;
  let since = performance.now();
  for (const file of folder.files.values()) {
    void file.size;
    count += 1;
    if (performance.now() - since > STILL_MS) {
      onCount(count);
      await new Promise((resolve) => setTimeout(resolve));
      since = performance.now();
    }
  }
}

/**
 * What was dropped: one archive, or a folder (several things dropped together are one folder).
 *
 * Must be called in the drop event itself: its items are gone afterwards.
 *
 * @param {DataTransfer} transfer
 * @param {OnCount} [onCount]
 * @returns {Promise<{archive: File} | {folder: Folder}>}
 */
export async function readDrop(transfer, onCount = () => {}) {
  const plain = [...transfer.files];
  const entries = [...transfer.items].filter(({ kind }) => kind === "file").map((item) => item.webkitGetAsEntry());
  if (plain.length === 1 && isArchive(plain[0].name) && !entries[0]?.isDirectory) return { archive: plain[0] };
  const files = new Map();
  const single = entries.length === 1 && entries[0]?.isDirectory ? entries[0] : null;
  for (const entry of entries) {
    if (entry) await walkEntry(entry, single ? "" : entry.name, files, onCount);
  }
  if (!entries.some(Boolean)) plain.forEach((file) => put(files, file.name, file));
  const name = single?.name ?? (entries.some((entry) => entry?.isDirectory) ? "drive" : nameOfFiles(plain));
  return { folder: { name, files } };
}

/** @param {FileSystemEntry} entry @param {string} path @param {Map<string, File>} files @param {OnCount} onCount */
async function walkEntry(entry, path, files, onCount) {
  if (entry.isFile) {
    const file = await new Promise((resolve, reject) => {
      /** @type {FileSystemFileEntry} */ (entry).file(resolve, reject);
    });
    put(files, path, file);
    if (files.size % 500 === 0) onCount(files.size);
    return;
  }
  const reader = /** @type {FileSystemDirectoryEntry} */ (entry).createReader();
  for (;;) {
    /** @type {FileSystemEntry[]} */
    const some = await new Promise((resolve, reject) => reader.readEntries(resolve, reject)); // a hundred at a time
    if (!some.length) return;
    await Promise.all(
      some.map((child) => walkEntry(child, path ? `${path}/${child.name}` : child.name, files, onCount)),
    );
  }
}

/** @param {Map<string, File>} files @param {string} path @param {File} file */
function put(files, path, file) {
  if (!JUNK.test(path)) files.set(path, file);
}
