/** Names of streets, written along them, beside the track, where the map is large enough. */
import { beginTexts, writeText } from "./paths.js";

/** @typedef {{x: number, y: number, angle: number}} Spot */
/**
 * @typedef {object} Taken A text or a sign on the map, pixels.
 * @property {number} x Of its middle.
 * @property {number} y
 * @property {string|null} name
 * @property {number} cos Of its direction.
 * @property {number} sin
 * @property {number} reach From its middle to its ends.
 */

const MIN_PER_METRE = 0.9; // pixels: zoom 17 in the middle latitudes
const MAX_ROAD_PX = 40; // as drawn
const MARGIN_PX = 12;
const APART_PX = 320; // labels of the same name
const LINE_PX = 15; // nearer than this, texts and signs overlap
const STRAIGHT = 0.985; // chord by arc: letters stand on one line

/**
 * @param {CanvasRenderingContext2D} context
 * @param {import("./surface.js").View} view
 * @param {{path: Float64Array, name: string|null, width: number}[]} roads Paths projected at zoom 0; widths in metres.
 * @param {Taken[]} taken What no name may lie on, as signs; these names are added to it.
 */
export function paintStreetNames(context, view, roads, taken) {
  if (view.perMetre < MIN_PER_METRE) return;
  context.save();
  beginTexts(context, "middle", "--ink-2");
  for (const { path, name, width: metres } of roads) {
    if (!name) continue;
    const beside = Math.min(metres * view.perMetre, MAX_ROAD_PX) / 2 + 8;
    const width = context.measureText(name).width;
    for (const spot of spots(path, view, width + MARGIN_PX)) {
      if (!view.shows(spot.x, spot.y)) continue;
      const text = besideOf(spot, beside, name, width);
      if (taken.some((other) => overlap(text, other))) continue;
      taken.push(text);
      context.save();
      context.translate(text.x, text.y);
      context.rotate(spot.angle);
      writeText(context, name, 0, 0);
      context.restore();
    }
  }
  context.restore();
}

/** @param {Spot} spot On the road. @param {number} beside Pixels. @param {string} name @param {number} width @returns {Taken} */
function besideOf({ x, y, angle }, beside, name, width) {
  const [cos, sin] = [Math.cos(angle), Math.sin(angle)];
  return { x: x + beside * sin, y: y - beside * cos, name, cos, sin, reach: width / 2 };
}

/** @param {Taken} a @param {Taken} b @returns {boolean} Whether they lie on each other, or say the same side by side. */
export function overlap(a, b) {
  const [dx, dy] = [b.x - a.x, b.y - a.y];
  const away = dx * dx + dy * dy;
  if (a.name !== null && a.name === b.name && away < APART_PX ** 2) return true;
  if (away > (a.reach + b.reach + LINE_PX) ** 2) return false;
  for (let i = -a.reach; i <= a.reach; i += stepOf(a)) {
    for (let k = -b.reach; k <= b.reach; k += stepOf(b)) {
      const [x, y] = [dx + k * b.cos - i * a.cos, dy + k * b.sin - i * a.sin];
      if (x * x + y * y < LINE_PX ** 2) return true;
    }
  }
  return false;
}

/** @param {Taken} taken @returns {number} Pixels between points along it, the last at its end. */
const stepOf = ({ reach }) => (2 * reach) / Math.ceil((2 * reach) / LINE_PX) - 1e-9 || 1;

/** @param {number} x Pixels. @param {number} y @returns {Taken} What a sign takes. */
export const takenBySign = (x, y) => ({ x, y, name: null, cos: 1, sin: 0, reach: 0 });

/**
 * Where a text of some length fits along a line: the middles of straight stretches, one after the other.
 * @param {Float64Array} path
 * @param {{x: (x: number) => number, y: (y: number) => number}} view
 * @param {number} length Pixels.
 */
export function spots(path, view, length) {
  /** @type {number[]} */
  const xs = [];
  /** @type {number[]} */
  const ys = [];
  const along = [0]; // distance of each corner from the start, pixels
  for (let i = 0; i < path.length; i += 2) {
    xs.push(view.x(path[i]));
    ys.push(view.y(path[i + 1]));
    const k = xs.length - 1;
    if (k) along.push(along[k - 1] + Math.hypot(xs[k] - xs[k - 1], ys[k] - ys[k - 1]));
  }
  const total = along[along.length - 1];
  /** @type {Spot[]} */
  const found = [];
  const tries = Math.floor(total / length) * 2 - 1;
  if (tries < 1) return found;
  let k = 0;
  /** @param {number} distance Ascending from call to call, but for the length of a text. @returns {[number, number]} */
  const at = (distance) => {
    while (k > 0 && along[k] > distance) k -= 1;
    while (k < along.length - 2 && along[k + 1] < distance) k += 1;
    const share = (distance - along[k]) / (along[k + 1] - along[k] || 1);
    return [xs[k] + share * (xs[k + 1] - xs[k]), ys[k] + share * (ys[k + 1] - ys[k])];
  };
  const rest = total - ((tries + 1) / 2) * length; // so that a single one stands in the middle
  for (let i = 0; i < tries; i += 1) {
    const start = rest / 2 + (i * length) / 2;
    const [x, y] = at(start);
    const [toX, toY] = at(start + length);
    if (Math.hypot(toX - x, toY - y) < STRAIGHT * length) continue;
    let angle = Math.atan2(toY - y, toX - x);
    if (Math.abs(angle) > Math.PI / 2) angle -= Math.sign(angle) * Math.PI; // never upside down
    found.push({ x: (x + toX) / 2, y: (y + toY) / 2, angle });
  }
  return found;
}
