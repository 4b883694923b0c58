/** Lines and areas on a canvas: projected once, to zoom 0, then painted as a view shows them. */

/** @import { View } from "./surface.js" */

const STEP_PX = 2; // a thousand tracks in one town have more points than pixels

/** @param {any} map @param {number[][]} places Longitude, latitude. @returns {Float64Array} x, y, x, y, ... at zoom 0. */
export function project(map, places) {
  const path = new Float64Array(2 * places.length);
  places.forEach(([lng, lat], i) => {
    ({ x: path[2 * i], y: path[2 * i + 1] } = map.options.crs.latLngToPoint({ lat, lng }, 0));
  });
  return path;
}

/** @param {CanvasRenderingContext2D} context @param {View} view @param {Float64Array[]} rings @param {string} fill @param {number} [edge] Width of a line around them. */
export function fillRings(context, view, rings, fill, edge = 0) {
  context.beginPath();
  for (const ring of rings) {
    for (let i = 0; i < ring.length; i += 2) context[i ? "lineTo" : "moveTo"](view.x(ring[i]), view.y(ring[i + 1]));
    context.closePath();
  }
  context.fillStyle = fill;
  context.fill();
  if (!edge) return;
  context.strokeStyle = fill;
  context.lineWidth = edge;
  context.stroke();
}

/**
 * @param {CanvasRenderingContext2D} context
 * @param {View} view
 * @param {Float64Array[]} paths
 * @param {string} stroke
 * @param {number} width
 * @param {number} [alpha]
 */
export function strokePaths(context, view, paths, stroke, width, alpha = 1) {
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
  context.strokeStyle = stroke;
  context.lineWidth = width;
  context.stroke();
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
