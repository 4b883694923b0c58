/** Several web workers that share the work of reducing scans. */

/** @typedef {{id: number, kind: string, task: object, resolve: (value: any) => void, reject: (error: Error) => void}} Item */

export class WorkerPool {
  /** @param {number} size Workers at most; they start when there is work for them. */
  constructor(size) {
    this.size = Math.max(1, size);
    /** @type {Item[]} */
    this.waiting = [];
    /** @type {Worker[]} */
    this.idle = [];
    /** @type {Map<Worker, Item>} */
    this.busy = new Map();
    this.count = 0;
  }

  /** One worker a core, at most eight: more only wait for the disk and the line. */
  static ofThisMachine() {
    return new WorkerPool(Math.min(8, navigator.hardwareConcurrency || 2));
  }

  /**
   * Let the next free worker do a task.
   *
   * @param {"reduce" | "count"} kind
   * @param {object} task
   * @returns {Promise<any>}
   */
  run(kind, task) {
    return new Promise((resolve, reject) => {
      this.count += 1;
      this.waiting.push({ id: this.count, kind, task, resolve, reject });
      this.#next();
    });
  }

  /** End all workers; what they were doing fails. */
  close() {
    const stopped = new Error("Stopped.");
    [...this.busy.keys(), ...this.idle].forEach((worker) => worker.terminate());
    [...this.busy.values(), ...this.waiting].forEach((item) => item.reject(stopped));
    this.busy.clear();
    this.waiting = [];
    this.idle = [];
  }

  #next() {
    while (this.waiting.length && (this.idle.length || this.busy.size < this.size)) {
      const worker = this.idle.pop() ?? this.#start();
      const item = /** @type {Item} */ (this.waiting.shift());
      this.busy.set(worker, item);
      worker.postMessage({ id: item.id, kind: item.kind, task: item.task });
    }
  }

  #start() {
    const worker = new Worker(new URL("./worker.js", import.meta.url), { type: "module" });
    worker.addEventListener("message", ({ data }) => {
      const item = this.busy.get(worker);
      if (!item || data.id !== item.id) {
        return;
      }
      this.busy.delete(worker);
      this.idle.push(worker);
      if (data.error === undefined) {
        item.resolve(data.result);
      } else {
        item.reject(new Error(data.error));
      }
      this.#next();
    });
    worker.addEventListener("error", (event) => {
      const item = this.busy.get(worker);
      this.busy.delete(worker);
      this.idle = this.idle.filter((other) => other !== worker);
      worker.terminate();
      item?.reject(
        new Error(`The part of the page that reduces scans stopped: ${event.message || "it did not load"}.`),
      );
      this.#next();
    });
    return worker;
  }
}
