/**
 * The signs of the map: each outcome has a colour and a shape, the same on the map, in the legend and in charts.
 * @module map/symbols
 */
import { svg } from "../dom.js";

/** @typedef {"disc"|"cross"|"ring"|"square"|"diamond"|"plus"|"dot"} Shape */

/**
 * Add a symbol to the path of a canvas context.
 * @param {CanvasRenderingContext2D|Path2D} path
 * @param {Shape} shape
 * @param {number} x
 * @param {number} y
 * @param {number} r Half its size.
 */
export function trace(path, shape, x, y, r) {
  if (shape === "disc" || shape === "ring" || shape === "dot") {
    path.moveTo(x + r, y);
    path.arc(x, y, r, 0, 2 * Math.PI);
  } else if (shape === "cross") {
    const d = 0.8 * r;
    path.moveTo(x - d, y - d);
    path.lineTo(x + d, y + d);
    path.moveTo(x - d, y + d);
    path.lineTo(x + d, y - d);
  } else if (shape === "square") {
    path.rect(x - r, y - r, 2 * r, 2 * r);
  } else if (shape === "diamond") {
    const d = 1.25 * r;
    path.moveTo(x, y - d);
    path.lineTo(x + d, y);
    path.lineTo(x, y + d);
    path.lineTo(x - d, y);
    path.closePath();
  } else {
    const t = 0.36 * r;
    path.moveTo(x - t, y - r);
    for (const [dx, dy] of [
      [t, -r],
      [t, -t],
      [r, -t],
      [r, t],
      [t, t],
      [t, r],
      [-t, r],
      [-t, t],
      [-r, t],
      [-r, -t],
      [-t, -t],
    ])
      path.lineTo(x + dx, y + dy);
    path.closePath();
  }
}

/** The signs by name: colour (a CSS variable), shape, whether it is filled, width of its line. */
export const SIGNS =
  /** @type {Record<string, {colour: string, shape: Shape, filled: boolean, width: number, edge?: string}>} */ ({
    detection: { colour: "--tp", shape: "disc", filled: true, width: 0 },
    tp: { colour: "--tp", shape: "disc", filled: true, width: 0 },
    fp: { colour: "--fp", shape: "cross", filled: false, width: 2 },
    found: { colour: "--found", shape: "square", filled: false, width: 2.4 },
    missed: { colour: "--missed", shape: "diamond", filled: false, width: 2.6 },
    outside: { colour: "--outside", shape: "square", filled: false, width: 1.2 },
    fused: { colour: "--fused", shape: "plus", filled: true, width: 1.2, edge: "--fused-edge" },
    keyframe: { colour: "--track", shape: "dot", filled: true, width: 0 },
  });

/** @param {string} name @returns {Element} The sign for legends and tables. */
export function signIcon(name) {
  const sign = SIGNS[name];
  const r = { dot: 2.5, disc: 4, cross: 5, plus: 6 }[/** @type {string} */ (sign.shape)] ?? 4.5;
  const recorder = new PathText();
  trace(/** @type {any} */ (recorder), sign.shape, 8, 8, r);
  return svg(
    "svg",
    { class: "sign", viewBox: "0 0 16 16", "aria-hidden": "true" },
    svg("path", {
      d: recorder.text,
      fill: sign.filled ? `var(${sign.colour})` : "none",
      stroke: sign.edge ? `var(${sign.edge})` : sign.width ? `var(${sign.colour})` : "none",
      "stroke-width": sign.width,
    }),
  );
}

/** Takes the calls of `trace` down as the data of an SVG path. */
class PathText {
  text = "";
  /** @param {number} x @param {number} y */
  moveTo(x, y) {
    this.text += `M${x} ${y}`;
  }
  /** @param {number} x @param {number} y */
  lineTo(x, y) {
    this.text += `L${x} ${y}`;
  }
  closePath() {
    this.text += "Z";
  }
  /** @param {number} x @param {number} y @param {number} w @param {number} h */
  rect(x, y, w, h) {
    this.text += `M${x} ${y}h${w}v${h}h${-w}Z`;
  }
  /** @param {number} x @param {number} y @param {number} r */
  arc(x, y, r) {
    this.text += `A${r} ${r} 0 1 1 ${x - r} ${y}A${r} ${r} 0 1 1 ${x + r} ${y}Z`;
  }
}

/** @param {string} variable @returns {string} The colour that a CSS variable stands for now. */
export function colour(variable) {
  return getComputedStyle(document.documentElement).getPropertyValue(variable).trim();
}
