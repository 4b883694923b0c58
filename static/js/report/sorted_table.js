/** A table whose rows lead to the map: sorted by any column, one stop of the Tab key, arrow keys from row to row. */
import { factRows } from "../controls.js";
import { el, fill } from "../dom.js";
import { signIcon } from "../map/symbols.js";

/**
 * @typedef {object} Column
 * @property {string} name
 * @property {string} meaning A sentence.
 * @property {(row: any) => number|string|null|undefined} value Rows without one come last.
 * @property {number} [digits] Of the value behind the point.
 * @property {(row: any) => any} [text] What the cell holds, if not the value itself.
 * @property {boolean} [down] Whether the largest come first at the first click.
 * @property {string} [class] Of its cells.
 */
/** @typedef {(a: any, b: any) => number} Order */

/**
 * @param {Column[]} columns Sorted by the first.
 * @param {object} options
 * @param {(row: any) => string} options.keyOf
 * @param {(row: any) => void} options.onChoose
 * @param {(order: Order) => void} [options.onSort]
 * @param {(row: any) => any} [options.below] What stands below a row, over its whole width; null for nothing.
 * @returns {{element: HTMLElement, show: (rows: any[]) => void, mark: (key: string|null) => void}}
 */
export function sortedTable(columns, { keyOf, onChoose, onSort, below }) {
  let column = 0;
  let down = Boolean(columns[0].down);
  /** @type {any[]} */
  let rows = [];
  /** @type {string|null} */
  let marked = null;
  const body = el("tbody", { onKeydown: (/** @type {KeyboardEvent} */ event) => move(event) });
  const heads = columns.map(({ name, meaning, class: kind }, i) => {
    const mark = el("span", { "aria-hidden": "true" });
    const button = el("button", { type: "button", onClick: () => sort(i) }, name, mark);
    return el("th", { scope: "col", class: kind, title: meaning }, button);
  });
  /** @param {any} a @param {any} b */
  const order = (a, b) => compare(columns[column].value(a), columns[column].value(b), down);

  /** @param {number} next */
  const sort = (next) => {
    down = next === column ? !down : Boolean(columns[next].down);
    column = next;
    update();
    onSort?.(order);
  };
  const update = () => {
    heads.forEach((head, i) => {
      head.setAttribute("aria-sort", i === column ? (down ? "descending" : "ascending") : "none");
      head.querySelector("span").textContent = i === column ? (down ? "▾" : "▴") : "";
    });
    rows.sort((a, b) => order(a, b) || compare(keyOf(a), keyOf(b), false));
    fill(body, ...rows.flatMap((row) => [rowOf(row), belowOf(row)]));
    markRows();
  };
  /** @param {any} row */
  const rowOf = (row) => {
    const cells = columns.map(({ value, digits, text = (each) => figure(value(each), digits), class: kind }) =>
      el("td", { class: kind }, text(row) ?? "–"),
    );
    const props = { class: "can", dataset: { key: keyOf(row) }, tabIndex: -1, title: "Show it on the map" };
    return el("tr", { ...props, onClick: () => onChoose(row) }, cells);
  };
  /** @param {any} row */
  const belowOf = (row) => {
    const more = below?.(row);
    const props = { class: "below", dataset: { key: keyOf(row) }, onClick: () => onChoose(row) };
    return more && el("tr", props, el("td", { colSpan: columns.length }, more));
  };
  /** @returns {any[]} Those that have a stop of the Tab key. */
  const stops = () => [...body.querySelectorAll("tr.can")];
  const markRows = () => {
    for (const row of body.children) row.classList.toggle("is", row.dataset.key === marked);
    const stop = body.querySelector("tr.can.is") ?? body.firstChild;
    for (const row of stops()) row.tabIndex = row === stop ? 0 : -1;
  };
  /** @param {KeyboardEvent} event */
  const move = (event) => {
    const row = /** @type {any} */ (event.target);
    if (row.parentElement !== body) return;
    const all = stops();
    const at = all.indexOf(row);
    const next = { ArrowDown: at + 1, ArrowUp: at - 1, Home: 0, End: all.length - 1 }[event.key];
    if (next !== undefined && all[next]) {
      row.tabIndex = -1;
      all[next].tabIndex = 0;
      all[next].focus();
    } else if (event.key === "Enter" || event.key === " ") onChoose(rows[at]);
    else if (next === undefined) return;
    event.preventDefault();
  };

  return {
    element: el("div.sorted", [
      el("table", el("thead", el("tr", heads)), body),
      el("details.small", [
        el("summary", "What the columns mean"),
        el("dl.meanings", factRows(columns.map(({ name, meaning }) => [name, meaning]))),
      ]),
    ]),
    show(next) {
      rows = [...next];
      update();
    },
    mark(key) {
      marked = key;
      markRows();
      body.querySelector(".is")?.scrollIntoView({ block: "nearest" });
    },
  };
}

/** @param {any} value @param {number} [digits] */
const figure = (value, digits) => (digits === undefined ? value : value?.toFixed(digits));

/**
 * The column of an outcome: its sign, whose name is read aloud.
 * @param {string} meaning
 * @param {Record<string, string>} names In the order of the table.
 * @param {(row: any) => string} signOf
 * @returns {Column}
 */
export function outcomeColumn(meaning, names, signOf) {
  const text = (/** @type {any} */ row) => {
    const name = names[signOf(row)];
    return el("span", { title: name }, signIcon(signOf(row)), el("span.unseen", name));
  };
  const value = (/** @type {any} */ row) => Object.keys(names).indexOf(signOf(row));
  return { name: "Outcome", class: "sign-cell", meaning, value, text };
}

/**
 * Numbers by their size, words by their letters with the numbers in them by their size; nothing comes last.
 * @param {any} a @param {any} b @param {boolean} down
 */
export function compare(a, b, down) {
  const [noA, noB] = [a ?? null, b ?? null].map((each) => each === null);
  if (noA || noB) return Number(noA) - Number(noB);
  const sign = typeof a === "number" ? a - b : String(a).localeCompare(String(b), "en", { numeric: true });
  return down ? -sign : sign;
}

/**
 * What stands below the row of an intersection or a node: its streets, and why its verdict is what it is.
 * @param {{names?: string|null, reason?: string|null}} properties
 * @param {...any} more
 */
export function belowRow({ names, reason }, ...more) {
  const parts = [names && el("b", names), reason && `${names ? " " : ""}${reason}`, ...more].filter(Boolean);
  return parts.length ? parts : null;
}
