/** The list of the intersections that were found: filtered, sorted, gone through one by one. */
import { iconButton } from "../controls.js";
import { el, fill, plural } from "../dom.js";
import { goTo, isNamed, ofService, serviceSwitch } from "../map/details.js";
import { clearFilter, getFilter, isFiltering, onFilterChange, setFilter } from "../map/filter.js";
import { VERDICTS, verdictOf } from "../map/layers.js";
import { queue, setOrder, step } from "../map/queue.js";
import { signIcon } from "../map/symbols.js";
import { getState, subscribe } from "../state.js";
import { belowRow, outcomeColumn, sortedTable } from "./sorted_table.js";

/** @import { Place, Result } from "../data/results.js" */
/** @import { Figure } from "../map/filter.js" */

/** @type {import("./sorted_table.js").Column[]} */
const COLUMNS = [
  outcomeColumn(
    "Right: an OSM intersection of its own lies within 10 m. Wrong: none does. Not scored: no map tells.",
    VERDICTS,
    verdictOf,
  ),
  {
    name: "Id",
    meaning: "Number of the intersection, in the order of first sight.",
    value: ({ properties: p }) => p.id,
  },
  {
    name: "Error",
    meaning: "Distance to its OSM intersection, metres; the uncertainty is in the details.",
    value: ({ properties: p }) => p.error_m,
    digits: 2,
    down: true,
  },
  {
    name: "±",
    meaning: "Uncertainty of the position, metres (1 σ along each axis).",
    value: ({ properties: p }) => p.position_std_m,
    digits: 2,
    down: true,
  },
  {
    name: "Conf.",
    meaning: "Confidence: probability that a road junction is within 10 m, percent.",
    value: ({ properties: p }) => p.confidence,
    text: ({ properties: p }) => `${Math.round(100 * p.confidence)} %`,
  },
  {
    name: "Seen",
    meaning: "Observations: detections that are part of it.",
    value: ({ properties: p }) => p.observations,
  },
];
/** Columns that only a score, or only its lack, has. */
const IF_SCORED = /** @type {Record<string, boolean>} */ ({ Outcome: true, Error: true });

/** @type {{figure: Figure, name: string, scale: number, step: string}[]} */
const RANGES = [
  { figure: "confidence", name: "Confidence, %", scale: 100, step: "1" },
  { figure: "observations", name: "Observations", scale: 1, step: "1" },
  { figure: "position_std_m", name: "Uncertainty (1 σ), m", scale: 1, step: "0.1" },
];

/** @param {Result} result */
export function intersectionList(result) {
  if (!result.intersections.length) return el("p.quiet", "No intersection was found on this drive.");
  const isScored = result.report !== null;
  const table = sortedTable(
    COLUMNS.filter(({ name }) => (IF_SCORED[name] ?? isScored) === isScored),
    {
      keyOf: ({ properties }) => String(properties.id),
      onChoose: (item) => goTo({ kind: "intersection", item }),
      onSort: setOrder,
      below: ({ properties: p }) => belowRow(p, ofService(p) && serviceSwitch(result)),
    },
  );
  setOrder(null);
  const count = el("span.number.quiet");
  const status = el("p.small", { role: "status" });
  const search = el("input.grow", {
    type: "search",
    placeholder: "Street, id, place or reason",
    "aria-label": "Find intersections by street, id, name of the place, or words of the reason",
    title: "A street, an id (3), a name of a place (n24546294), or words of the reason (worth a look)",
    value: getFilter().words,
    onInput: () => setFilter({ words: search.value }),
    onKeydown: (/** @type {KeyboardEvent} */ event) => event.key === "Enter" && step(1),
  });
  const more = filterFields(result);
  const empty = el("p.small", { hidden: true }, "No intersection passes the filter. ", showAll());

  const mark = () => {
    const name = getState().intersection;
    const places = queue();
    const at = places.findIndex((each) => isNamed(name, each));
    table.mark(at < 0 ? null : String(places[at].properties.id));
    fill(count, `${at < 0 ? "–" : at + 1} / ${places.length}`);
  };
  const update = () => {
    const places = queue();
    const all = plural(result.intersections.length, "intersection");
    fill(status, isFiltering() ? [`${places.length} of ${all}, here and on the map. `, showAll()] : `${all}.`);
    empty.hidden = places.length > 0;
    table.element.hidden = !places.length;
    if (document.activeElement !== search) search.value = getFilter().words;
    table.show(places);
    mark();
  };
  update();
  const stops = [
    subscribe(["intersection", "panel"], () => isShown() && requestAnimationFrame(mark)),
    onFilterChange(() => isShown() && update()),
  ];
  const isShown = () => {
    if (!table.element.isConnected) for (const stop of stops) stop();
    return table.element.isConnected;
  };
  requestAnimationFrame(mark);
  return el("div.stack-s.intersections", [
    el("div.tools.spread", [
      search,
      iconButton("previous", "Previous intersection", () => step(-1), "Previous intersection of the list (p)"),
      count,
      iconButton("next", "Next intersection", () => step(1), "Next intersection of the list (n)"),
    ]),
    more,
    status,
    empty,
    table.element,
  ]);
}

const showAll = () => el("button.link", { type: "button", onClick: clearFilter }, "Show all");

/** @param {Result} result */
function filterFields(result) {
  const verdicts = /** @type {const} */ (["wrong", "right", "not_counted", "unscored"])
    .map((name) => ({ name, many: result.intersections.filter((each) => verdictOf(each) === name).length }))
    .filter(({ many }) => many > 0);
  const filter = getFilter();
  const boxes = verdicts.map(({ name, many }) => {
    const checked = !filter.verdicts || filter.verdicts.includes(name);
    const input = el("input", { type: "checkbox", value: name, checked, onChange: () => choose() });
    return { input, element: el("label.key-row", input, signIcon(name), `${VERDICTS[name]} (${many})`) };
  });
  const choose = () => {
    const on = boxes.filter(({ input }) => input.checked).map(({ input }) => input.value);
    setFilter({ verdicts: on.length === boxes.length ? null : on });
  };
  const ranges = RANGES.map((range) => rangeFields(range, result.intersections));
  const stop = onFilterChange(() => {
    if (!element.isConnected) return stop();
    const { verdicts: on } = getFilter();
    for (const { input } of boxes) input.checked = !on || on.includes(input.value);
    for (const each of ranges) each.update();
  });
  const element = el("details.filter", { open: filter.verdicts !== null || Object.keys(filter.ranges).length > 0 }, [
    el("summary", "Filter"),
    el("div.stack-s", [
      boxes.length > 1 && el("fieldset.row", [el("legend.unseen", "Outcome"), boxes.map((each) => each.element)]),
      el("div.ranges", [ranges.map(({ elements }) => elements)]),
    ]),
  ]);
  return element;
}

/** @param {typeof RANGES[0]} range @param {Place[]} places */
function rangeFields({ figure, name, scale, step: by }, places) {
  const values = places.map(({ properties }) => properties[figure] * scale).filter(Number.isFinite);
  const digits = by === "1" ? 0 : 2;
  const bounds = [Math.min(...values), Math.max(...values)].map((each) => each.toFixed(digits));
  const inputs = ["least", "most"].map((bound, i) => {
    const words = { placeholder: bounds[i], "aria-label": `${name}, at ${bound}` };
    return el("input", { type: "number", min: "0", step: by, ...words, onInput: () => read() });
  });
  const read = () => {
    const [least, most] = inputs.map(({ value }) => (value === "" ? null : Number(value) / scale));
    setFilter({ ranges: { ...getFilter().ranges, [figure]: [least, most] } });
  };
  const update = () => {
    const range = getFilter().ranges[figure] ?? [null, null];
    inputs.forEach((input, i) => {
      const bound = range[i];
      if (document.activeElement !== input) input.value = bound === null ? "" : String(+(bound * scale).toFixed(3));
    });
  };
  update();
  return {
    elements: [el("span", name), inputs[0], el("span", { "aria-hidden": "true" }, "to"), inputs[1]],
    update,
  };
}
