/**
 * Sends files of one drive: several at once, again where the connection or the server fails for a while.
 *
 * Pausing, stopping, retrying and digests of what is sent are here, since only the browser can do them.
 */

import { ApiError, encodePath, putFile, request, sha256, sleep } from "../api.js";
import { readWhole } from "./reduce.js";

/** One connection less than browsers open to a server, so that the page can still ask for something. */
export const PARALLEL = 5;

/** Larger files are sent without a digest: to compute one, the whole file is read into memory. */
export const DIGEST_MAX_BYTES = 512 * 1024 * 1024;
const GIVE_UP_MS = 15 * 60_000;
const MAX_WAIT_MS = 30_000;
const DAMAGED_TRIES = 3;

const WINDOW_MS = 15_000;
const STEP_MS = 500;

/** How much was sent, how fast, and how long the rest will take. */
export class Meter {
  /** @param {() => number} [now] Milliseconds. */
  constructor(now = () => performance.now()) {
    this.now = now;
    this.sent = 0;
    /** Bytes that are to be sent in all; an estimate while scans are being reduced. */
    this.total = 0;
    /** Bytes that were there already. */
    this.skipped = 0;
    /** @type {[number, number][]} Time and bytes sent until then. */
    this.marks = [];
  }

  /** @param {number} bytes Less than nothing takes back what has to be sent again. */
  add(bytes) {
    this.sent += bytes;
    const time = this.now();
    const last = this.marks.at(-1);
    if (!last || time - last[0] >= STEP_MS) this.marks.push([time, this.sent]);
    while (this.marks.length > 2 && time - this.marks[0][0] > WINDOW_MS) this.marks.shift();
  }

  /** Forget the speed: after a pause it means nothing. */
  restart() {
    this.marks = [];
  }

  /** @returns {number} 0..1 */
  get fraction() {
    const all = this.total + this.skipped;
    return all > 0 ? Math.min(1, (this.sent + this.skipped) / all) : 0;
  }

  /** @returns {number | null} Bytes per second; null where it is too early to tell. */
  get speed() {
    const first = this.marks[0];
    const seconds = first ? (this.now() - first[0]) / 1000 : 0;
    return first && seconds > 1 ? Math.max(0, this.sent - first[1]) / seconds : null;
  }

  get secondsLeft() {
    const speed = this.speed;
    return speed ? Math.max(0, this.total - this.sent) / speed : null;
  }
}

/** So much may go on at once; the rest waits for its turn. */
export class Turns {
  /** @type {(() => void)[]} */
  #waiting = [];

  /** @param {number} free */
  constructor(free) {
    this.free = free;
  }

  /** @template T @param {() => Promise<T>} work */
  async run(work) {
    if (this.free > 0) this.free -= 1;
    else await new Promise((/** @type {(value: void) => void} */ resolve) => this.#waiting.push(resolve));
    try {
      return await work();
    } finally {
      const next = this.#waiting.shift();
      if (next) next();
      else this.free += 1;
    }
  }
}

export class Transfer {
  /** @param {() => void} onChange Called whenever something is worth showing. */
  constructor(onChange) {
    this.onChange = onChange;
    this.meter = new Meter();
    this.drive = "";
    /** What it waits for, in words; null while all is well. @type {string | null} */
    this.waiting = null;
    this.stopper = new AbortController();
    /** @type {{promise: Promise<void>, open: () => void} | null} */
    this.gate = null;
    this.connections = new Turns(PARALLEL);
  }

  get signal() {
    return this.stopper.signal;
  }

  get isPaused() {
    return this.gate !== null;
  }

  /** Begin nothing more; what is being sent arrives. */
  pause() {
    if (this.gate) return;
    let open = () => {};
    const promise = new Promise((/** @type {(value: void) => void} */ resolve) => (open = resolve));
    this.gate = { promise, open };
    this.onChange();
  }

  resume() {
    this.gate?.open();
    this.gate = null;
    this.meter.restart();
    this.onChange();
  }

  stop() {
    this.stopper.abort(new DOMException("The upload was stopped.", "AbortError"));
    this.gate?.open();
    this.gate = null;
  }

  /** Wait while paused; throws where the upload was stopped. */
  async waitWhilePaused() {
    while (this.gate) await this.gate.promise;
    this.signal.throwIfAborted();
  }

  /**
   * Do something for each of many items, some at once; the first failure ends it.
   *
   * @template T
   * @param {Iterable<T>} items
   * @param {number} atOnce
   * @param {(item: T) => Promise<void>} work
   */
  async each(items, atOnce, work) {
    const iterator = items[Symbol.iterator]();
    let failed = false;
    const lane = async () => {
      for (let next = iterator.next(); !next.done && !failed; next = iterator.next()) {
        try {
          await this.waitWhilePaused();
          await work(next.value);
        } catch (error) {
          failed = true;
          throw error;
        }
      }
    };
    const lanes = await Promise.allSettled(Array.from({ length: atOnce }, lane));
    const bad = lanes.find((result) => result.status === "rejected");
    if (bad) throw /** @type {PromiseRejectedResult} */ (bad).reason;
  }

  /**
   * Send one file.
   *
   * @param {string} path Inside the drive.
   * @param {Blob | Uint8Array<ArrayBuffer>} data
   * @param {string | null} [digest] SHA-256 in Base64, where it is known.
   * @returns {Promise<{path: string, size_bytes: number, sha256: string}>}
   */
  async put(path, data, digest = null) {
    const size = data instanceof Blob ? data.size : data.byteLength;
    if (!digest && size <= DIGEST_MAX_BYTES) {
      digest = await sha256(data instanceof Blob ? await readWhole(data, path) : data, "base64");
    }
    return this.send(`drives/${this.drive}/files/${encodePath(path)}`, data, { digest });
  }

  /**
   * Send a body, counting its bytes.
   *
   * @param {string} path Of the service.
   * @param {Blob | Uint8Array<ArrayBuffer>} data
   * @param {{digest?: string | null, method?: string}} [options]
   */
  async send(path, data, options = {}) {
    const size = data instanceof Blob ? data.size : data.byteLength;
    await this.waitWhilePaused();
    return this.retry(() =>
      this.connections.run(async () => {
        let counted = 0;
        const count = (/** @type {number} */ sent) => {
          const step = Math.min(sent, size) - counted;
          counted += step;
          this.meter.add(step);
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
      }),
    );
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
        this.meter.restart();
        this.onChange();
        await Promise.race([sleep(wait, this.signal), backOnline(this.signal)]);
      }
    }
  }
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
