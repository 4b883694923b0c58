/**
 * Sends the files of one drive: small ones in bundles, some requests at once, again where the connection or the server
 * fails for a while.
 *
 * Reducing scans, stopping, and digests of what is sent are here, since only the browser can do them.
 */

import { ApiError, encodePath, isMap, newKey, putFile, request, sha256, sleep } from "../api.js";
import { bytesOf } from "./drive_folder.js";
import { readWhole } from "./reduce.js";

/**
 * @typedef {object} Item A file that the service is to have.
 * @property {string} path Inside the drive.
 * @property {number} size Bytes; about as many where it is made.
 * @property {File} [file] It is sent as it is,
 * @property {() => object} [task] or it is what a worker makes by this.
 */
/** @typedef {{worker: Worker | null}} Lane What works through the queue, with a worker once it needs one. */
/** @typedef {{path: string, data: Blob | Uint8Array<ArrayBuffer>, size: number, digest: string | null}} Content To be sent. */

/** One connection less than browsers open to a server, so that the page can still ask for something. */
const PARALLEL = 5;
/** Files up to this size travel together. */
const SMALL_BYTES = 1024 * 1024;
const BUNDLE_BYTES = 8 * 1024 * 1024;
const BUNDLE_FILES = 32;
const ROUNDS = 4;
/** Larger files are sent without a digest: to compute one, the whole file is read into memory. */
const DIGEST_MAX_BYTES = 512 * 1024 * 1024;
const PAGE = 10_000;
const GIVE_UP_MS = 15 * 60_000;
const MAX_WAIT_MS = 30_000;
const DAMAGED_TRIES = 3;

/** How much was sent, how fast, and how long the rest will take. */
export class Meter {
  sent = 0;
  /** Bytes that are to be sent in all; an estimate while scans are being reduced. */
  total = 0;
  /** Bytes that were there already. */
  skipped = 0;
  #began;

  /** @param {() => number} [now] Milliseconds. */
  constructor(now = () => performance.now()) {
    this.now = now;
    this.#began = now();
  }

  /** @returns {number} 0..1 */
  get fraction() {
    const all = this.total + this.skipped;
    return all > 0 ? Math.min(1, (this.sent + this.skipped) / all) : 0;
  }

  /** @returns {number | null} Bytes per second; null where it is too early to tell. */
  get speed() {
    const seconds = (this.now() - this.#began) / 1000;
    return this.sent > 0 && seconds > 1 ? this.sent / seconds : null;
  }

  get secondsLeft() {
    return this.speed && Math.max(0, this.total - this.sent) / this.speed;
  }
}

export class Transfer {
  meter = new Meter();
  /** Id of the drive. */
  drive = "";
  /** What it waits for, in words; null while all is well. @type {string | null} */
  waiting = null;
  #stopper = new AbortController();

  /**
   * @param {() => void} onChange Called whenever something is worth showing.
   * @param {Set<string>} [arrived] Paths of what was sent before from the very same files: it is not read again.
   */
  constructor(onChange, arrived = new Set()) {
    this.onChange = onChange;
    this.arrived = arrived;
  }

  get signal() {
    return this.#stopper.signal;
  }

  /** Send nothing more; what is on its way is given up, and sent again when it goes on. */
  stop() {
    this.#stopper.abort(new DOMException("The upload was stopped.", "AbortError"));
  }

  /** @returns {Promise<Map<string, {size_bytes: number, digest: string}>>} What the service has of the drive, by path. */
  async present() {
    const present = new Map();
    for (let after = ""; ; ) {
      const query = `limit=${PAGE}${after && `&after=${encodeURIComponent(after)}`}`;
      const { body } = await this.ask(`drives/${this.drive}/files?${query}`);
      for (const { path, size_bytes, sha256: hex } of body.files) {
        const bytes = hex.replace(/../g, (/** @type {string} */ pair) => String.fromCharCode(parseInt(pair, 16)));
        present.set(path, { size_bytes, digest: btoa(bytes) });
      }
      if (!body.next) return present;
      after = body.next;
    }
  }

  /** Remove what the service has besides some paths and maps: it has gone from the folder. @param {Set<string>} paths */
  async removeOthers(paths) {
    for (const path of (await this.present()).keys()) {
      if (paths.has(path) || path === "reduced.json" || isMap(path)) continue;
      await this.ask(`drives/${this.drive}/files/${encodePath(path)}`, { method: "DELETE" });
    }
  }

  /**
   * Send what the service lacks of some files, from one queue; the first failure ends it.
   *
   * @param {Item[]} items
   * @param {(done: number) => void} onDone Called with the number of files that are there.
   */
  async sendAll(items, onDone) {
    const present = await this.present();
    const queue = items.values();
    const bundled = Math.min(BUNDLE_FILES, Math.ceil(items.length / (ROUNDS * PARALLEL))); // of few files no lane has all
    let done = 0;
    /** @type {{error: unknown} | null} */
    let fault = null;
    const lane = async () => {
      /** @type {Lane} */
      const own = { worker: null };
      /** @type {Content[]} */
      let bundle = [];
      const send = async (/** @type {Content[]} */ contents) => {
        await this.#send(contents);
        for (const { path } of contents) this.arrived.add(path);
        onDone((done += contents.length));
      };
      try {
        for (const item of queue) {
          this.signal.throwIfAborted();
          if (fault) return;
          const content = await this.#contentOf(item, present.get(item.path), own);
          if (!content) onDone((done += 1));
          else if (content.size > SMALL_BYTES || /["%\\\p{C}]/u.test(content.path)) await send([content]);
          else bundle.push(content);
          if (bundle.length >= bundled || bytesOf(bundle) >= BUNDLE_BYTES) {
            await send(bundle);
            bundle = [];
          }
        }
        if (bundle.length) await send(bundle);
      } catch (error) {
        fault ??= { error };
      } finally {
        own.worker?.terminate();
      }
    };
    this.meter.total += items.reduce((sum, { size }) => sum + size, 0);
    await Promise.all(Array.from({ length: PARALLEL }, () => lane()));
    if (fault) throw /** @type {{error: unknown}} */ (fault).error;
  }

  /**
   * @param {Item} item
   * @param {{size_bytes: number, digest: string} | undefined} there What the service has under its name.
   * @param {Lane} lane
   * @returns {Promise<Content | null>} null where the service has it.
   */
  async #contentOf({ path, size: expected, file, task }, there, lane) {
    const skip = (/** @type {number} */ bytes) => {
      this.meter.total -= expected;
      this.meter.skipped += bytes;
      this.onChange();
      return null;
    };
    if (there && this.arrived.has(path)) return skip(there.size_bytes);
    const content = file ? await contentOf(file, path) : await this.retry(() => made(lane, task?.()));
    if (content.digest !== null && content.digest === there?.digest) return skip(there.size_bytes);
    const size = content.data instanceof Blob ? content.data.size : content.data.byteLength;
    this.meter.total += size - expected;
    return { path, size, ...content };
  }

  /** Send a file, or several small ones in one request: all of them arrive, or none. @param {Content[]} contents */
  async #send(contents) {
    const [{ path, data, digest }] = contents;
    if (contents.length === 1) return this.send(`drives/${this.drive}/files/${encodePath(path)}`, data, { digest });
    const boundary = newKey();
    const parts = contents.flatMap((each) => [
      `--${boundary}\r\nContent-Disposition: form-data; name="files"; filename="${each.path}"\r\n`,
      each.digest ? `Content-Digest: sha-256=:${each.digest}:\r\n\r\n` : "\r\n",
      each.data,
      "\r\n",
    ]);
    const type = `multipart/form-data; boundary=${boundary}`;
    const body = new Blob([...parts, `--${boundary}--\r\n`]);
    return this.send(`drives/${this.drive}/scans`, body, { method: "POST", type, size: bytesOf(contents) });
  }

  /**
   * Send a body, counting its bytes.
   *
   * @param {string} path Of the service.
   * @param {Blob | Uint8Array<ArrayBuffer>} data
   * @param {{digest?: string | null, method?: string, type?: string, size?: number}} [options] `size`: what counts of it.
   */
  async send(path, data, { size = data instanceof Blob ? data.size : data.byteLength, ...options } = {}) {
    this.signal.throwIfAborted();
    return this.retry(async () => {
      let counted = 0;
      const count = (/** @type {number} */ sent) => {
        const step = Math.min(sent, size) - counted;
        counted += step;
        this.meter.sent += step;
        this.onChange();
      };
      try {
        const answer = await putFile(path, data, { ...options, onProgress: count, signal: this.signal });
        count(size);
        return answer;
      } catch (error) {
        count(0);
        throw error;
      }
    });
  }

  /** Ask the service for something. @param {string} path @param {Parameters<typeof request>[1]} [options] */
  async ask(path, options = {}) {
    return this.retry(async () => {
      const response = await request(path, { ...options, signal: this.signal });
      const text = await response.text();
      return { status: response.status, body: text ? JSON.parse(text) : null };
    });
  }

  /**
   * Try again while what is wrong may pass: no connection, a server that restarts or is busy.
   *
   * @template T
   * @param {() => Promise<T>} work
   */
  async retry(work) {
    const began = Date.now();
    for (let tries = 1; ; tries += 1) {
      try {
        const result = await work();
        this.waiting = null;
        return result;
      } catch (error) {
        this.signal.throwIfAborted();
        const isDamaged =
          error instanceof ApiError && error.status === 422 && /digest/i.test(error.title) && tries < DAMAGED_TRIES;
        const isPassing = error instanceof ApiError && error.isPassing && Date.now() - began < GIVE_UP_MS;
        if (!isDamaged && !isPassing) throw error;
        const wait = waitFor(tries, /** @type {ApiError} */ (error).retryAfter);
        this.waiting = `${/** @type {ApiError} */ (error).title}. Trying again in ${Math.ceil(wait / 1000)} s.`;
        this.onChange();
        await Promise.race([sleep(wait, this.signal), backOnline(this.signal)]);
      }
    }
  }
}

/** A file with its SHA-256 in Base64; a small one is read only once. @param {File} file @param {string} path */
async function contentOf(file, path) {
  if (file.size > DIGEST_MAX_BYTES) return { data: file, digest: null };
  const bytes = new Uint8Array(await readWhole(file, path));
  return { data: file.size > SMALL_BYTES ? file : bytes, digest: await sha256(bytes) };
}

/** @param {Lane} lane @param {any} task @returns {Promise<{data: Uint8Array<ArrayBuffer>, digest: string | null}>} */
function made(lane, task) {
  lane.worker ??= new Worker(new URL("./worker.js", import.meta.url), { type: "module" });
  const { worker } = lane;
  return new Promise((resolve, reject) => {
    worker.onmessage = ({ data: answer }) =>
      answer.error === undefined ? resolve(answer) : reject(new Error(answer.error));
    worker.onerror = ({ message }) => {
      lane.worker = null;
      worker.terminate();
      const detail = "The part of the page that reduces scans did not load.";
      if (message) reject(new Error(`The part of the page that reduces scans stopped: ${message}.`));
      else reject(new ApiError(0, { title: "Server not reached", detail })); // it may be back soon
    };
    worker.postMessage(task);
  });
}

/** @param {number} tries @param {number | null} asked Seconds that the server asked for. @returns {number} Milliseconds. */
function waitFor(tries, asked) {
  const own = Math.min(MAX_WAIT_MS, 500 * 2 ** tries) * (0.75 + Math.random() / 2); // not all lanes at once
  return asked === null ? own : Math.min(asked * 1000, 2 * MAX_WAIT_MS);
}

/** @param {AbortSignal} signal @returns {Promise<void>} When the browser says that it is connected again. */
function backOnline(signal) {
  return new Promise((resolve) => {
    globalThis.addEventListener?.("online", () => resolve(), { once: true, signal });
  });
}
