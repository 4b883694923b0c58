/** The signs of the map: each outcome has a colour and a shape, the same on the map, in the legend and in charts. */
import { svg } from "../dom.js";
import { fill, stroke } from "./paths.js";

/**
 * @typedef {"disc"|"cross"|"ring"|"square"|"diamond"|"dot"|"triangle"|"check"|"bang"|"gap"|"fork"|"hexagon"
 *   |"vehicle"} Shape
 */

/** @param {string} text "x y x y, x y x y" @returns {number[][][]} Lines of points. */
const lines = (text) => text.split(",").map((line) => [...line.matchAll(/(\S+) (\S+)/g)].map(([, x, y]) => [+x, +y]));

/** Outlines of the shapes that are not round, at half size 1. */
const OUTLINES = /** @type {Partial<Record<Shape, number[][][]>>} */ ({
  cross: lines("-.8 -.8 .8 .8, -.8 .8 .8 -.8"),
  square: lines("-1 -1 1 -1 1 1 -1 1"),
  diamond: lines("0 -1.25 1.25 0 0 1.25 -1.25 0"),
  hexagon: lines("0 -1.15 1 -.58 1 .58 0 1.15 -1 .58 -1 -.58"),
  triangle: lines("0 -1 1.15 1 -1.15 1"),
  check: lines("-.5 0 -.15 .38 .5 -.38"),
  bang: lines("0 -.4 0 .32, 0 .68 0 .7"),
  gap: lines("-.5 0 .5 0"),
  fork: lines("0 .55 0 0 -.46 -.4, 0 0 .46 -.4"),
  vehicle: lines("0 -1.3 .9 1 0 .5 -.9 1"),
});
const OPEN = new Set(["cross", "check", "bang", "gap", "fork"]);

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
    if (!OPEN.has(shape)) path.closePath();
  }
}

/**
 * @typedef {object} Sign
 * @property {string} colour A CSS variable.
 * @property {Shape} shape
 * @property {boolean} filled
 * @property {number} width Of its line.
 * @property {string} [edge] Colour of the line, if it is another one.
 * @property {Shape} [glyph] Drawn in it in the colour of the ground: the verdict is read without its colour.
 * @property {boolean} [rim] Whether it stands out from what it lies on by a rim.
 */

/** The signs by name. */
export const SIGNS = /** @type {Record<string, Sign>} */ ({
  detections: { colour: "--tp", shape: "disc", filled: true, width: 0 },
  tp: { colour: "--tp", shape: "disc", filled: true, width: 0 },
  fp: { colour: "--fp", shape: "cross", filled: false, width: 2, rim: true },
  found: { colour: "--found", shape: "square", filled: false, width: 2, rim: true },
  missed: { colour: "--missed", shape: "diamond", filled: true, width: 1.6, edge: "--surface", glyph: "gap" },
  outside: { colour: "--outside", shape: "square", filled: false, width: 1.2 },
  right: { colour: "--right", shape: "disc", filled: true, width: 1.6, edge: "--surface", glyph: "check" },
  wrong: { colour: "--wrong", shape: "triangle", filled: true, width: 1.6, edge: "--surface", glyph: "bang" },
  unscored: { colour: "--fused", shape: "disc", filled: true, width: 1.6, edge: "--surface", glyph: "fork" },
  not_counted: { colour: "--ink-2", shape: "disc", filled: true, width: 1.6, edge: "--surface", glyph: "fork" },
  here: { colour: "--tp", shape: "hexagon", filled: false, width: 1.8 },
  elsewhere: { colour: "--tp", shape: "square", filled: false, width: 1.8 },
  keyframes: { colour: "--track", shape: "dot", filled: true, width: 0 },
});

/**
 * Paint signs of one kind.
 * @param {CanvasRenderingContext2D} context
 * @param {Sign} sign
 * @param {number[][]} spots Pixels.
 * @param {number} r Half their size.
 * @param {number} [alpha]
 */
export function paintSigns(context, sign, spots, r, alpha = 1) {
  if (!spots.length) return;
  context.beginPath();
  for (const [x, y] of spots) trace(context, sign.shape, x, y, r);
  context.globalAlpha = alpha;
  if (sign.rim) stroke(context, "--surface", sign.width + 2.5);
  if (sign.filled) fill(context, sign.colour);
  if (sign.width) stroke(context, sign.edge ?? sign.colour, sign.width);
  if (sign.glyph) {
    context.beginPath();
    for (const [x, y] of spots) trace(context, sign.glyph, x, y, r);
    stroke(context, "--surface", r / 4);
  }
  context.globalAlpha = 1;
}

const RADII = /** @type {Partial<Record<Shape, number>>} */ ({ dot: 2.5, disc: 4, cross: 5, triangle: 6.5 });

/** How lines and areas look in the legend: paths of a square of 16. @type {Record<string, Record<string, any>[]>} */
const LOOKS = {
  tiles: [{ d: "M1.5 2.5h13v11h-13zM8 2.5v11M1.5 8h13", stroke: "var(--ink-3)" }],
  surface: [{ d: "M0 3h16v10H0z", fill: "var(--seen-road)" }],
  roads: [{ d: "M.5 4.5h15v7H.5z", fill: "var(--road-road)", stroke: "var(--road-road-casing)" }],
  measured: [{ d: "M1 5h14v6H1z", fill: "var(--measured-inside)", stroke: "var(--measured)", "stroke-width": 1.5 }],
  track: [{ d: "M0 8h16", stroke: "var(--track)", "stroke-width": 2 }],
  places: [{ d: "M0 8h16", stroke: "var(--track)", "stroke-width": 1.5, opacity: 0.45 }],
  uncertainty: [
    {
      d: "M1.5 8a6.5 6.5 0 1 1 13 0a6.5 6.5 0 1 1-13 0",
      fill: "var(--right)",
      "fill-opacity": 0.25,
      stroke: "var(--right)",
    },
  ],
  branches: [{ d: "M0 8h16", stroke: "var(--right)", "stroke-width": 2 }],
  errors: [{ d: "M1 12 15 4", stroke: "var(--tp)", "stroke-width": 1.5 }],
  zone: [
    { d: "M1.75 1.75h12.5v12.5H1.75z", stroke: "var(--roi)", "stroke-width": 1.5, "stroke-dasharray": "3 2" },
    { d: "M5.25 5.25h5.5v5.5h-5.5z", stroke: "var(--roi)", "stroke-width": 1.5 },
  ],
};

/** @param {string} name @returns {Element} The sign, or the look of a line or area, for legends and tables. */
export function signIcon(name) {
  const paths = LOOKS[name]?.map((each) => svg("path", { fill: "none", ...each }));
  return svg("svg.sign", { viewBox: "0 0 16 16", "aria-hidden": "true" }, paths ?? marksOf(SIGNS[name]));
}

/** @param {Sign} sign */
function marksOf({ colour, shape, filled, width, edge, glyph }) {
  const r = shape === "disc" && glyph ? 7 : glyph === "gap" ? 6 : (RADII[shape] ?? 4.5);
  const line = glyph ? "none" : edge ? `var(${edge})` : width ? `var(${colour})` : "none";
  const props = { fill: filled ? `var(${colour})` : "none", stroke: line, "stroke-width": width };
  const mark = { fill: "none", stroke: "var(--surface)", "stroke-width": 1.8, "stroke-linecap": "round" };
  return [
    OUTLINES[shape] ? svg("path", { d: outlineOf(shape, r), ...props }) : svg("circle", { cx: 8, cy: 8, r, ...props }),
    glyph && svg("path", { d: outlineOf(glyph, r), ...mark }),
  ];
}

/** @param {Shape} shape @param {number} r */
function outlineOf(shape, r) {
  const path = (/** @type {number[][]} */ line) => `M${line.map(([x, y]) => `${8 + r * x} ${8 + r * y}`).join("L")}`;
  return OUTLINES[shape]?.map(path).join("") + (OPEN.has(shape) ? "" : "Z");
}
