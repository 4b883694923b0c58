/**
 * The signs of the map: each outcome has a colour and a shape, the same on the map, in the legend and in charts.
 * @module map/symbols
 */
import { svg } from "../dom.js";

/** @typedef {"disc"|"cross"|"ring"|"square"|"diamond"|"plus"|"dot"|"hexagon"|"down"} Shape */

/** @param {string} text "x y x y, x y x y" @returns {number[][][]} Lines of points. */
const lines = (text) => text.split(",").map((line) => [...line.matchAll(/(\S+) (\S+)/g)].map(([, x, y]) => [+x, +y]));

/** Outlines of the shapes that are not round, at half size 1; all but the cross are closed. */
const OUTLINES = /** @type {Partial<Record<Shape, number[][][]>>} */ ({
  cross: lines("-.8 -.8 .8 .8, -.8 .8 .8 -.8"),
  square: lines("-1 -1 1 -1 1 1 -1 1"),
  diamond: lines("0 -1.25 1.25 0 0 1.25 -1.25 0"),
  hexagon: lines("0 -1.15 1 -.58 1 .58 0 1.15 -1 .58 -1 -.58"),
  down: lines("0 1.3 1.2 -.8 -1.2 -.8"),
  plus: lines("-.36 -1 .36 -1 .36 -.36 1 -.36 1 .36 .36 .36 .36 1 -.36 1 -.36 .36 -1 .36 -1 -.36 -.36 -.36"),
});

/**
 * Add a symbol to the path of a canvas context.
 * @param {CanvasRenderingContext2D} path
 * @param {Shape} shape
 * @param {number} x
 * @param {number} y
 * @param {number} r Half its size.
 */
export function trace(path, shape, x, y, r) {
  const outline = OUTLINES[shape];
  if (!outline) {
    path.moveTo(x + r, y);
    path.arc(x, y, r, 0, 2 * Math.PI);
    return;
  }
  for (const [[dx, dy], ...rest] of outline) {
    path.moveTo(x + r * dx, y + r * dy);
    for (const [px, py] of rest) path.lineTo(x + r * px, y + r * py);
    if (shape !== "cross") path.closePath();
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
    wrong: { colour: "--fp", shape: "cross", filled: false, width: 4 },
    shared: { colour: "--ink-2", shape: "ring", filled: false, width: 1.4 },
    here: { colour: "--tp", shape: "hexagon", filled: false, width: 1.8 },
    elsewhere: { colour: "--warn", shape: "down", filled: false, width: 1.8 },
    keyframe: { colour: "--track", shape: "dot", filled: true, width: 0 },
  });

/** @param {string} name @returns {Element} The sign for legends and tables. */
export function signIcon(name) {
  const sign = SIGNS[name];
  const r = { dot: 2.5, disc: 4, cross: 5, plus: 6 }[/** @type {string} */ (sign.shape)] ?? 4.5;
  const props = {
    fill: sign.filled ? `var(${sign.colour})` : "none",
    stroke: sign.edge ? `var(${sign.edge})` : sign.width ? `var(${sign.colour})` : "none",
    "stroke-width": sign.width,
  };
  const path = (/** @type {number[][]} */ line) => `M${line.map(([x, y]) => `${8 + r * x} ${8 + r * y}`).join("L")}`;
  const d = OUTLINES[sign.shape]?.map(path).join("") + (sign.shape === "cross" ? "" : "Z");
  const round = !OUTLINES[sign.shape];
  const shape = round ? svg("circle", { cx: 8, cy: 8, r, ...props }) : svg("path", { d, ...props });
  return svg("svg", { class: "sign", viewBox: "0 0 16 16", "aria-hidden": "true" }, shape);
}

/** @param {string} variable @returns {string} The colour that a CSS variable stands for now. */
export function colour(variable) {
  return getComputedStyle(document.documentElement).getPropertyValue(variable).trim();
}
