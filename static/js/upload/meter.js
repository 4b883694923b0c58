/** How much was sent, how fast, and how long the rest will take. */

const WINDOW_MS = 15_000;
const STEP_MS = 500;

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

  /** Forget the speed: after a pause it says nothing. */
  restart() {
    this.marks = [];
  }

  /** @returns {number} 0..1 */
  get fraction() {
    const all = this.total + this.skipped;
    return all > 0 ? Math.min(1, (this.sent + this.skipped) / all) : 0;
  }

  /** @returns {number | null} Bytes a second; null where it is too early to tell. */
  get speed() {
    const first = this.marks[0];
    const seconds = first ? (this.now() - first[0]) / 1000 : 0;
    return first && seconds > 1 ? Math.max(0, this.sent - first[1]) / seconds : null;
  }

  /** @returns {number | null} */
  get secondsLeft() {
    const speed = this.speed;
    return speed ? Math.max(0, this.total - this.sent) / speed : null;
  }
}
