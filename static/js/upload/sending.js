/** The files of a drive to be sent to the service: small files in batches, scans as they are, or reduced. */

import { getConfig, sha256 } from "../api.js";
import { inFolder, numberedFiles, pathOf } from "./drive_folder.js";
import { DIGEST_MAX_BYTES, PARALLEL, Turns } from "./transfer.js";

/** @import { DriveFolder, LabelsMeaning, NumberedLook } from "./drive_folder.js" */
/** @import { Transfer } from "./transfer.js" */
/** @typedef {Map<string, {size_bytes: number, sha256: string}>} Present Files that the service has, by path. */

const SMALL_BYTES = 1024 * 1024;
const BATCH_FROM = 20;
const MAX_BATCH_FILES = 500;
const BATCH_BYTES = 8 * 1024 * 1024;
const PAGE = 10_000;

/** @param {Transfer} transfer */
export async function listPresent(transfer) {
  /** @type {Present} */
  const present = new Map();
  for (let after = ""; ; ) {
    const query = `limit=${PAGE}${after && `&after=${encodeURIComponent(after)}`}`;
    const { body } = await transfer.ask(`drives/${transfer.drive}/files?${query}`);
    for (const file of body.files) present.set(file.path, file);
    if (!body.next) return present;
    after = body.next;
  }
}

/**
 * Send poses, calibration, times, OXTS and maps; those that are there already are left out.
 *
 * @param {Transfer} transfer
 * @param {Map<string, File>} files
 * @param {Present} present
 */
export async function sendSmallFiles(transfer, files, present) {
  /** @type {[string, File][]} */
  const missing = [];
  for (const [path, file] of files) {
    await transfer.waitWhilePaused();
    if (await isPresent(file, present.get(path))) skip(transfer, file.size);
    else missing.push([path, file]);
  }
  const small = missing.filter(([, file]) => file.size <= SMALL_BYTES);
  const batched = small.length >= BATCH_FROM ? batches(small) : [];
  const single = small.length >= BATCH_FROM ? missing.filter(([, file]) => file.size > SMALL_BYTES) : missing;
  await transfer.each(single, PARALLEL, async ([path, file]) => {
    await transfer.put(path, file);
  });
  await transfer.each(batched, 2, (batch) => sendBatch(transfer, batch));
}

/** @param {[string, File][]} files */
function batches(files) {
  const maxFiles = Math.min(MAX_BATCH_FILES, getConfig().limits.max_batch_files ?? MAX_BATCH_FILES);
  /** @type {[string, File][][]} */
  const all = [];
  let bytes = Infinity;
  for (const each of files) {
    if (bytes + each[1].size > BATCH_BYTES || /** @type {any[]} */ (all.at(-1)).length >= maxFiles) {
      all.push([]);
      bytes = 0;
    }
    bytes += each[1].size;
    /** @type {any[]} */ (all.at(-1)).push(each);
  }
  return all;
}

/** @param {Transfer} transfer @param {[string, File][]} batch */
async function sendBatch(transfer, batch) {
  const form = new FormData();
  for (const [path, file] of batch) form.append("files", file, path);
  await transfer.ask(`drives/${transfer.drive}/scans`, { method: "POST", body: form });
  transfer.meter.add(batch.reduce((sum, [, file]) => sum + file.size, 0));
  transfer.onChange();
}

/**
 * @param {Blob} file
 * @param {{size_bytes: number, sha256: string} | undefined} there
 * @returns {Promise<boolean>} True where the service has the same bytes; false where the file is too large to tell.
 */
async function isPresent(file, there) {
  if (!there || there.size_bytes !== file.size || file.size > DIGEST_MAX_BYTES) return false;
  const own = await sha256(await file.arrayBuffer(), "hex");
  return own === null || own === there.sha256;
}

/** @param {Transfer} transfer @param {number} bytes */
function skip(transfer, bytes) {
  transfer.meter.total -= bytes;
  transfer.meter.skipped += bytes;
  transfer.onChange();
}

/**
 * Send files as they are.
 *
 * @param {Transfer} transfer
 * @param {[string, File][]} files
 * @param {Present} present
 * @param {boolean} isTrusted These are the very files that the upload began with: equal sizes are enough.
 * @param {(done: number) => void} onDone
 */
export async function sendFiles(transfer, files, present, isTrusted, onDone) {
  let done = 0;
  await transfer.each(files, PARALLEL, async ([path, file]) => {
    const there = present.get(path);
    if (there && there.size_bytes === file.size && (isTrusted || (await isPresent(file, there))))
      skip(transfer, file.size);
    else await transfer.put(path, file);
    done += 1;
    onDone(done);
  });
}

/**
 * Reduce scans in workers and send what is left of them.
 *
 * @param {Transfer} transfer
 * @param {object} what
 * @param {DriveFolder} what.drive
 * @param {number[]} what.frames Scans to send.
 * @param {string[]} what.folders Of labels.
 * @param {number} what.groundBytes About the size of what is left of a scan, by all folders.
 * @param {Present} what.present
 * @param {Set<string>} what.trusted Label folders whose files on the service are known to be good.
 * @param {(done: number) => void} onDone
 */
export async function sendReduced(transfer, { drive, frames, folders, groundBytes, present, trusted }, onDone) {
  const { scans, labels } = drive.look;
  const items = frames.flatMap((frame) => folders.map((folder) => ({ frame, folder })));
  const pool = new WorkerPool();
  const { meter } = transfer;
  const expected = groundBytes / folders.length; // of each file, until it is there
  meter.total += expected * items.length;
  const fileOf = (/** @type {string} */ path) => drive.folder.files.get(inFolder(drive, path));
  let done = 0;
  try {
    await transfer.each(items, pool.size + PARALLEL, async ({ frame, folder }) => {
      const path = `ground/${folder}/${String(frame).padStart(6, "0")}.ground`;
      const there = present.get(path);
      if (there && trusted.has(folder)) {
        meter.total += there.size_bytes - expected;
        skip(transfer, there.size_bytes);
      } else {
        const scanName = pathOf(/** @type {NumberedLook} */ (scans), frame);
        const labelName = pathOf(labels[folder], frame);
        const files = { scan: fileOf(scanName), labels: fileOf(labelName), scanName, labelName };
        if (!files.labels) throw new Error(`${labelName}: is missing. Expected one .label file per scan.`);
        const { road, confusable } = labels[folder];
        const { bytes, digest } = await pool.run({ files, scheme: { road, confusable } });
        meter.total += bytes.byteLength - expected;
        if (there && there.sha256 === (await sha256(bytes, "hex"))) skip(transfer, bytes.byteLength);
        else await transfer.put(path, bytes, digest);
      }
      done += 1;
      onDone(done);
    });
  } finally {
    pool.close();
  }
}

/**
 * The manifest of the reduced drive: what the service planned, with the name and the sizes that only the browser knows.
 *
 * @param {DriveFolder} drive
 * @param {string} name
 * @param {string[]} folders Of labels.
 */
export function manifestBytes(drive, name, folders) {
  const { look } = drive;
  const planned = look.plan?.manifest;
  const scans = /** @type {NumberedLook} */ (look.scans);
  const points = numberedFiles(drive, scans)
    .map(([, file]) => Math.floor(file.size / 16))
    .sort((a, b) => a - b);
  const middle = points.length / 2;
  const median = points.length % 2 ? points[Math.floor(middle)] : (points[middle - 1] + points[middle]) / 2;
  const labels = planned.labels
    .filter((/** @type {any} */ { folder }) => folders.includes(folder))
    .map((/** @type {any} */ each) => ({ ...each, label_bytes: look.labels[each.folder].size_bytes }));
  const source = {
    scan_bytes: scans.size_bytes,
    points_per_scan: Math.floor(median),
    least_points: points[0],
    most_points: points.at(-1),
  };
  const manifest = { ...planned, name: name.replaceAll("/", "_"), labels, source };
  return new TextEncoder().encode(`${JSON.stringify(manifest, null, 1)}\n`);
}

const STOPPED = new Error("Stopped.");

/** Several web workers that share the work of reducing scans. */
class WorkerPool {
  /** One worker per core, at most eight: more would only wait for the disk and the network. */
  size = Math.min(8, navigator.hardwareConcurrency || 2);
  #turns = new Turns(this.size);
  /** @type {Worker[]} */
  #idle = [];
  /** What ends the tasks under way. @type {Set<(error: Error) => void>} */
  #busy = new Set();
  #isClosed = false;

  /** Let the next free worker do a task. @param {object} task @returns {Promise<any>} */
  run(task) {
    return this.#turns.run(async () => {
      if (this.#isClosed) throw STOPPED;
      const worker = this.#idle.pop() ?? new Worker(new URL("./worker.js", import.meta.url), { type: "module" });
      const answer = await this.#ask(worker, task);
      this.#idle.push(worker);
      if (answer.error !== undefined) throw new Error(answer.error);
      return answer;
    });
  }

  /** End all workers; what they were doing fails. */
  close() {
    this.#isClosed = true;
    for (const worker of this.#idle) worker.terminate();
    for (const fail of this.#busy) fail(STOPPED); // who wait come to their turns, and end
  }

  /** @param {Worker} worker @param {object} task @returns {Promise<any>} */
  #ask(worker, task) {
    return new Promise((resolve, reject) => {
      const fail = (/** @type {Error} */ error) => (worker.terminate(), this.#busy.delete(fail), reject(error));
      worker.onmessage = ({ data }) => (this.#busy.delete(fail), resolve(data));
      worker.onerror = ({ message }) =>
        fail(new Error(`The part of the page that reduces scans stopped: ${message || "it did not load"}.`));
      this.#busy.add(fail);
      worker.postMessage(task);
    });
  }
}
