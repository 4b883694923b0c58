/** Lines, areas and texts on a canvas: projected once, to zoom 0, then painted as a view shows them. */
import { el } from "../dom.js";

/** @import { View } from "./surface.js" */

/** Colours by the CSS variables that stand for them. @type {Map<string, string>} */
const colours = new Map();
globalThis.matchMedia?.("(prefers-color-scheme: dark)").addEventListener("change", () => colours.clear());

/** @param {string} variable Of CSS. @returns {string} Its colour as it is now: a canvas knows no variables. */
export function colour(variable) {
  if (!colours.has(variable)) {
    const probe = el("span", { style: { color: `var(${variable})`, forcedColorAdjust: "none" } });
    document.body.append(probe);
    colours.set(variable, getComputedStyle(probe).color);
    probe.remove();
  }
  return /** @type {string} */ (colours.get(variable));
}

/** Draw along the path of a context. @param {CanvasRenderingContext2D} context @param {string} variable @param {number} width */
export function stroke(context, variable, width) {
  context.strokeStyle = colour(variable);
  context.lineWidth = width;
  context.stroke();
}

/** Fill the path of a context. @param {CanvasRenderingContext2D} context @param {string} variable */
export function fill(context, variable) {
  context.fillStyle = colour(variable);
  context.fill();
}

/** Make a context ready for texts. @param {CanvasRenderingContext2D} context @param {CanvasTextBaseline} baseline @param {string} variable */
export function beginTexts(context, baseline, variable) {
  context.font = `600 12px ${getComputedStyle(document.body).fontFamily}`;
  context.textAlign = "center";
  context.textBaseline = baseline;
  context.lineWidth = 3;
  context.strokeStyle = colour("--ground");
  context.fillStyle = colour(variable);
}

/** Write a text that stands out from what it lies on. @param {CanvasRenderingContext2D} context @param {string} text @param {number} x @param {number} y */
export function writeText(context, text, x, y) {
  context.strokeText(text, x, y);
  context.fillText(text, x, y);
}

const STEP_PX = 2; // a thousand tracks in one town have more points than pixels

/** @param {any} map @param {number[][]} places Longitude, latitude. @returns {Float64Array} x, y, x, y, ... at zoom 0. */
export function project(map, places) {
  const path = new Float64Array(2 * places.length);
  places.forEach(([lng, lat], i) => {
    ({ x: path[2 * i], y: path[2 * i + 1] } = map.options.crs.latLngToPoint({ lat, lng }, 0));
  });
  return path;
}

/** @param {CanvasRenderingContext2D} context @param {View} view @param {Float64Array[]} rings @param {string} variable @param {number} [edge] Width of a line around them. */
export function fillRings(context, view, rings, variable, edge = 0) {
  context.beginPath();
  for (const ring of rings) {
    for (let i = 0; i < ring.length; i += 2) context[i ? "lineTo" : "moveTo"](view.x(ring[i]), view.y(ring[i + 1]));
    context.closePath();
  }
  fill(context, variable);
  if (edge) stroke(context, variable, edge);
}

/**
 * @param {CanvasRenderingContext2D} context
 * @param {View} view
 * @param {Float64Array[]} paths
 * @param {string} variable
 * @param {number} width
 * @param {number} [alpha]
 */
export function strokePaths(context, view, paths, variable, width, alpha = 1) {
  context.beginPath();
  for (const path of paths) {
    let [lastX, lastY] = [0, 0];
    for (let i = 0; i < path.length; i += 2) {
      const x = view.x(path[i]);
      const y = view.y(path[i + 1]);
      const isEnd = i === path.length - 2;
      if (i && !isEnd && Math.abs(x - lastX) + Math.abs(y - lastY) < STEP_PX) continue;
      if (i) context.lineTo(x, y);
      else context.moveTo(x, y);
      [lastX, lastY] = [x, y];
    }
  }
  context.globalAlpha = alpha;
  stroke(context, variable, width);
  context.globalAlpha = 1;
}

/** @param {Float64Array} path @param {View} view @param {number} x @param {number} y @returns {{away: number, at: [number, number]}} Pixels, and the nearest place at zoom 0. */
export function nearestOn(path, view, x, y) {
  let away = Infinity;
  let at = /** @type {[number, number]} */ ([path[0], path[1]]);
  for (let i = 2; i < path.length; i += 2) {
    const [ax, ay] = [view.x(path[i - 2]), view.y(path[i - 1])];
    const [dx, dy] = [view.x(path[i]) - ax, view.y(path[i + 1]) - ay];
    const t = Math.max(0, Math.min(1, ((x - ax) * dx + (y - ay) * dy) / (dx * dx + dy * dy || 1)));
    const d = Math.hypot(ax + t * dx - x, ay + t * dy - y);
    if (d >= away) continue;
    away = d;
    at = [path[i - 2] + t * (path[i] - path[i - 2]), path[i - 1] + t * (path[i + 1] - path[i - 1])];
  }
  return { away, at };
}
