/** The files of a drive to be sent to the service: small files in batches, scans as they are, or reduced. */

import { getConfig, sha256 } from "../api.js";
import { pathOf } from "./drive_folder.js";
import { DIGEST_MAX_BYTES, PARALLEL, Turns } from "./transfer.js";

/** @import { DriveFolder, NumberedFiles } from "./drive_folder.js" */
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

/** @param {DriveFolder} drive @param {string[]} folders @returns {[string, File][]} Scan by scan. */
export function rawFiles(drive, folders) {
  const labels = folders.map((folder) => drive.labels[folder]);
  if (!drive.scans) {
    const ofLabels = labels.flatMap((kind) => [...kind.files].map(([frame, file]) => [pathOf(kind, frame), file]));
    return [...drive.recorded, .../** @type {[string, File][]} */ (ofLabels)];
  }
  const kinds = [drive.scans, ...labels];
  return [...drive.scans.files.keys()].flatMap((frame) =>
    kinds.flatMap((kind) => {
      const file = kind.files.get(frame);
      return file ? [/** @type {[string, File]} */ ([pathOf(kind, frame), file])] : [];
    }),
  );
}

/**
 * Reduce scans in workers and send what is left of them.
 *
 * @param {Transfer} transfer
 * @param {object} what
 * @param {DriveFolder} what.drive
 * @param {number[]} what.frames Scans to send.
 * @param {Map<string, import("./upload.js").JudgedLabels>} what.schemes By label folder.
 * @param {number} what.groundBytes About the size of what is left of a scan.
 * @param {Present} what.present
 * @param {Set<string>} what.trusted Label folders whose files on the service are known to be good.
 * @param {(done: number) => void} onDone
 */
export async function sendReduced(transfer, { drive, frames, schemes, groundBytes, present, trusted }, onDone) {
  const scans = /** @type {NumberedFiles} */ (drive.scans);
  const items = frames.flatMap((frame) => [...schemes.keys()].map((folder) => ({ frame, folder })));
  const pool = new WorkerPool();
  const estimate = new Estimate(transfer.meter, items.length, groundBytes * items.length);
  let done = 0;
  try {
    await transfer.each(items, pool.size + PARALLEL, async ({ frame, folder }) => {
      const path = `ground/${folder}/${String(frame).padStart(6, "0")}.ground`;
      const there = present.get(path);
      if (there && trusted.has(folder)) {
        estimate.add(there.size_bytes);
        skip(transfer, there.size_bytes);
      } else {
        const labels = drive.labels[folder];
        const files = {
          scan: scans.files.get(frame),
          labels: labels.files.get(frame),
          scanName: pathOf(scans, frame),
          labelName: pathOf(labels, frame),
        };
        if (!files.labels) throw new Error(`${files.labelName}: is missing. Expected one .label file per scan.`);
        const { bytes, digest } = await pool.run({ files, scheme: schemes.get(folder) });
        estimate.add(bytes.byteLength);
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

/** Bytes of all reduced scans, extrapolated from those that are done. */
class Estimate {
  /** @param {import("./transfer.js").Meter} meter @param {number} count @param {number} expected Before any is done. */
  constructor(meter, count, expected) {
    this.meter = meter;
    this.left = count;
    this.sum = 0;
    this.done = 0;
    this.expected = expected;
    meter.total += expected;
  }

  /** @param {number} bytes Of one more scan. */
  add(bytes) {
    this.left -= 1;
    this.done += 1;
    this.sum += bytes;
    const expected = this.sum + (this.left * this.sum) / this.done;
    this.meter.total += expected - this.expected;
    this.expected = expected;
  }
}

/**
 * The manifest of the reduced drive: what the service planned, with the sizes that only the browser knows.
 *
 * @param {any} planned
 * @param {DriveFolder} drive
 */
export function manifestBytes(planned, drive) {
  const scans = /** @type {NumberedFiles} */ (drive.scans);
  const points = [...scans.files.values()].map((file) => Math.floor(file.size / 16)).sort((a, b) => a - b);
  const middle = points.length / 2;
  const median = points.length % 2 ? points[Math.floor(middle)] : (points[middle - 1] + points[middle]) / 2;
  const labels = planned.labels.map((/** @type {any} */ each) => ({
    ...each,
    label_bytes: drive.labels[each.folder].bytes,
  }));
  const source = {
    scan_bytes: scans.bytes,
    points_per_scan: Math.floor(median),
    least_points: points[0],
    most_points: points.at(-1),
  };
  return new TextEncoder().encode(`${JSON.stringify({ ...planned, labels, source }, null, 1)}\n`);
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
