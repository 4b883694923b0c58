/** Charts: lines over a distance, and bars; with axes, and a cursor that reads them out. */
import { el, fill, formatCount, formatPercent, svg } from "../dom.js";

const W = 360;
const BOX = { left: 34, right: 8, top: 8, bottom: 30 };
const MIDDLE = (BOX.left + W - BOX.right) / 2;

/** @param {number} x Of its middle. @param {number} y @param {string} text */
const centred = (x, y, text) => svg("text", { x, y, "text-anchor": "middle" }, text);

/** @param {number} y @param {string} text Beside the axis. */
const beside = (y, text) => svg("text", { x: BOX.left - 6, y, "text-anchor": "end" }, text);

/** @param {string} kind Class. @param {number} y */
const across = (kind, y) => svg(`line.${kind}`, { x1: BOX.left, x2: W - BOX.right, y1: y, y2: y });

/** The mark of a line in a key. @param {string} colour @param {string} [dash] */
export function lineKey(colour, dash) {
  const borderTopStyle = !dash ? "solid" : dash.startsWith("2") ? "dotted" : "dashed";
  return el("i.key", { style: { borderColor: colour, borderTopStyle } });
}

/**
 * @typedef {{name: string, colour: string, dash?: string, points: Array<[number, number|null]>}} Line y in 0..1.
 */

/**
 * Shares over D.
 * @param {Line[]} lines
 * @param {{max: number, mark: number, onMark: (x: number) => void}} options `mark`: the D at hand; a click chooses another.
 */
export function lineChart(lines, { max, mark, onMark }) {
  const h = 190;
  const x = (/** @type {number} */ d) => BOX.left + (d / max) * (W - BOX.left - BOX.right);
  const y = (/** @type {number} */ share) => BOX.top + (1 - share) * (h - BOX.top - BOX.bottom);
  const xs = lines[0].points.map(([d]) => d).filter((d) => d <= max);
  const cursor = svg("line.cursor", { y1: BOX.top, y2: h - BOX.bottom });
  const dots = lines.map((line) => svg("circle", { r: 3.5, fill: line.colour, visibility: "hidden" }));
  const keys = el("div.keys.row");
  let current = mark;
  /** @param {number} d */
  const read = (d) => {
    cursor.setAttribute("x1", String(x(d)));
    cursor.setAttribute("x2", String(x(d)));
    const texts = lines.map(({ name, colour, dash, points }, i) => {
      const value = points.find(([each]) => each === d)?.[1] ?? null;
      dots[i].setAttribute("visibility", value === null ? "hidden" : "visible");
      dots[i].setAttribute("cx", String(x(d)));
      dots[i].setAttribute("cy", String(y(value ?? 0)));
      return el("span.key-row", lineKey(colour, dash), `${name} ${formatPercent(value)}`);
    });
    fill(keys, el("strong", `At D = ${d} m`), texts);
  };
  const nearest = (/** @type {PointerEvent} */ event) => {
    const box = chart.getBoundingClientRect();
    const d = ((((event.clientX - box.left) / box.width) * W - BOX.left) / (W - BOX.left - BOX.right)) * max;
    return xs.reduce((best, each) => (Math.abs(each - d) < Math.abs(best - d) ? each : best), xs[0]);
  };
  const choose = (/** @type {number} */ d) => {
    current = d;
    read(d);
    onMark(d);
  };
  const chart = svg(
    "svg.chart",
    {
      viewBox: `0 0 ${W} ${h}`,
      tabindex: 0,
      role: "slider",
      "aria-label": "Distance D at which a detection counts as true",
      "aria-valuemin": xs[0],
      "aria-valuemax": xs.at(-1),
      "aria-valuenow": mark,
      "aria-valuetext": `${mark} metres`,
      onPointermove: (/** @type {PointerEvent} */ event) => read(nearest(event)),
      onPointerleave: () => read(current),
      onClick: (/** @type {PointerEvent} */ event) => choose(nearest(event)),
      onKeydown: (/** @type {KeyboardEvent} */ event) => {
        const step = { ArrowRight: 1, ArrowUp: 1, ArrowLeft: -1, ArrowDown: -1 }[event.key];
        if (!step) return;
        event.preventDefault();
        choose(xs[Math.max(0, Math.min(xs.length - 1, xs.indexOf(current) + step))]);
        chart.setAttribute("aria-valuenow", String(current));
        chart.setAttribute("aria-valuetext", keys.textContent ?? "");
      },
    },
    [
      [0, 0.25, 0.5, 0.75, 1].map((share) => [
        across("grid", y(share)),
        beside(y(share) + 4, `${100 * share}${share === 1 ? " %" : ""}`),
      ]),
      Array.from({ length: max / 2 + 1 }, (_, i) => centred(x(2 * i), h - BOX.bottom + 14, String(2 * i))),
      centred(MIDDLE, h - 3, "distance D [m]"),
      lines.map((line) =>
        svg("polyline.curve", {
          stroke: line.colour,
          "stroke-dasharray": line.dash,
          points: line.points
            .filter(([d, value]) => d <= max && value !== null)
            .map(([d, value]) => `${x(d).toFixed(1)},${y(value ?? 0).toFixed(1)}`)
            .join(" "),
        }),
      ),
      cursor,
      dots,
    ],
  );
  read(mark);
  return el("div.stack-s", chart, keys);
}

/**
 * Counts of errors.
 * @param {number[]} counts The last one includes all beyond.
 * @param {{width: number, limit: number}} options `width` of a bin; from `limit` on bars are in the colour of false.
 */
export function barChart(counts, { width, limit }) {
  const h = 130;
  const max = Math.max(1, ...counts);
  const step = (W - BOX.left - BOX.right) / counts.length;
  const y = (/** @type {number} */ count) => BOX.top + (1 - count / max) * (h - BOX.top - BOX.bottom);
  const total = counts.reduce((sum, each) => sum + each, 0);
  const legend = el("p.small.number");
  const describe = (/** @type {number|null} */ i) => {
    const limitText = `${counts.at(-1)} beyond ${(counts.length - 1) * width} m`;
    if (i === null) return fill(legend, `${formatCount(total)} matched detections; ${limitText}.`);
    const range = i === counts.length - 1 ? `beyond ${i * width} m` : `${i * width} to ${(i + 1) * width} m`;
    const share = formatPercent(counts[i] / Math.max(1, total));
    fill(legend, `${formatCount(counts[i])} detections (${share}) ${range} off.`);
  };
  describe(null);
  const chart = svg(
    "svg.chart",
    {
      viewBox: `0 0 ${W} ${h}`,
      role: "img",
      "aria-label": "Histogram of the errors",
      onPointerleave: () => describe(null),
    },
    [
      beside(BOX.top + 6, formatCount(max)),
      across("grid", y(max)),
      across("axis", y(0)),
      counts.map((count, i) => [
        svg("rect", {
          class: `bar${i * width >= limit ? " fp" : ""}`,
          x: BOX.left + i * step + 0.5,
          y: y(count),
          width: step - 1,
          height: y(0) - y(count),
        }),
        svg("rect", {
          fill: "transparent",
          x: BOX.left + i * step,
          y: BOX.top,
          width: step,
          height: y(0) - BOX.top,
          onPointerenter: () => describe(i),
        }),
      ]),
      counts.map((_, i) => {
        const text = `${i * width}${i === counts.length - 1 ? "+" : ""}`;
        return (i * width) % 2 === 0 && centred(BOX.left + i * step, h - BOX.bottom + 14, text);
      }),
      centred(MIDDLE, h - 3, "center error [m]"),
    ],
  );
  return el("div", chart, legend);
}
