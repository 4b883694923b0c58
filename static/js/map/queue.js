/** The intersections one after the other, as the list has them: filtered and sorted, by keys or buttons. */
import { announce } from "../dom.js";
import { getState, subscribe } from "../state.js";
import { goTo, isNamed } from "./details.js";
import { titleOf } from "./facts.js";
import { passes } from "./filter.js";
import { VERDICTS, verdictOf } from "./layers.js";
import { shown } from "./shown.js";

/** @import { Place } from "../data/results.js" */
/** @typedef {(a: Place, b: Place) => number} Order */

const ORDER = Object.keys(VERDICTS);

/** @type {Order} */
const byVerdict = (a, b) => ORDER.indexOf(verdictOf(a)) - ORDER.indexOf(verdictOf(b));

let order = byVerdict;
/** The one that was looked at last: its details may be closed by now. @type {Place|null} */
let last = null;

subscribe(["intersection"], ({ intersection }) => {
  last = shown.result?.intersections.find((each) => isNamed(intersection, each)) ?? last;
});

/** @param {Order|null} next Of the list; null for the usual one. */
export function setOrder(next) {
  order = next ?? byVerdict;
}

export function queue() {
  return (shown.result?.intersections ?? [])
    .filter(passes)
    .sort((a, b) => order(a, b) || a.properties.id - b.properties.id);
}

/** Go to the next or the previous intersection; behind the last comes the first. @param {1|-1} by */
export function step(by) {
  const places = queue();
  if (!places.length) return announce("No intersection passes the filter.");
  const name = getState().intersection;
  const at = places.findIndex((each) => (name === null ? each === last : isNamed(name, each)));
  const next = at < 0 ? (by > 0 ? 0 : places.length - 1) : (at + by + places.length) % places.length;
  const hit = /** @type {const} */ ({ kind: "intersection", item: places[next] });
  goTo(hit);
  announce(`${titleOf(hit)}, ${next + 1} of ${places.length}`);
}

/** Keys that work anywhere but in fields: for the list of shortcuts. */
export const QUEUE_KEYS = [
  { key: "n", text: "Next intersection of the list", run: () => step(1) },
  { key: "p", text: "Previous intersection of the list", run: () => step(-1) },
];
