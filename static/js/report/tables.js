/** The list of the intersections that were found, filtered, sorted, gone through one by one; and that of the map's. */
import { iconButton } from "../controls.js";
import { el, fill, plural } from "../dom.js";
import { goTo, goToNode, isNamed } from "../map/details.js";
import { onFilterChange, setFilter } from "../map/filter.js";
import { kindOfNode, NODE_OUTCOMES, VERDICTS, verdictOf } from "../map/layers.js";
import { queue, setOrder, step } from "../map/queue.js";
import { getState, subscribe } from "../state.js";
import { belowRow, outcomeColumn, sortedTable } from "./sorted_table.js";

/** @import { Result } from "../data/results.js" */

/** @type {import("./sorted_table.js").Column[]} */
const COLUMNS = [
  outcomeColumn(
    "Right: an OSM intersection of its own lies within 10 m. Wrong: none does. Not counted: the policy leaves it out. Not scored: no map tells.",
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
      below: ({ properties }) => belowRow(properties),
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
    value: getState().filter ?? "",
    onInput: () => setFilter(search.value),
    onKeydown: (/** @type {KeyboardEvent} */ event) => event.key === "Enter" && step(1),
  });
  const mark = () => {
    const places = queue();
    const at = places.findIndex((each) => isNamed(getState().intersection, each));
    table.mark(at < 0 ? null : String(places[at].properties.id));
    fill(count, `${at < 0 ? "–" : at + 1} / ${places.length}`);
  };
  const update = () => {
    const { filter } = getState();
    const places = queue();
    const all = plural(result.intersections.length, "intersection");
    const showAll = el("button.link", { type: "button", onClick: () => setFilter("") }, "Show all");
    fill(status, filter ? [`${places.length} of ${all}, here and on the map. `, showAll] : `${all}.`);
    table.element.hidden = !places.length;
    if (document.activeElement !== search) search.value = filter ?? "";
    table.show(places);
    mark();
  };
  update();
  followWhileShown(table.element, ["intersection", "panel"], mark);
  const stop = onFilterChange(() => (table.element.isConnected ? update() : stop()));
  return el("div.stack-s.intersections", [
    el("div.tools.spread", [
      search,
      iconButton("previous", "Previous intersection", () => step(-1), "Previous intersection of the list (p)"),
      count,
      iconButton("next", "Next intersection", () => step(1), "Next intersection of the list (n)"),
    ]),
    status,
    table.element,
  ]);
}

/** All OSM intersections that the drive could or did find. @param {Result} result */
export function nodeTable({ report }) {
  const table = sortedTable(
    [
      outcomeColumn(
        "Found: an intersection of the map is assigned to it, one to one, within 10 m.",
        NODE_OUTCOMES,
        (properties) => kindOfNode({ properties }),
      ),
      {
        name: "Error",
        meaning: "Distance of the intersection of the map that is assigned to it, metres.",
        value: (node) => node.map_error_m,
        digits: 2,
        down: true,
      },
    ],
    {
      keyOf: ({ osm_id }) => String(osm_id),
      below: (node) => belowRow({ ...node, names: `${node.names ?? "Node"} ` }, el("span.number", ` ${node.osm_id}`)),
      onChoose: ({ osm_id }) => goToNode(osm_id),
    },
  );
  table.show(report.nodes);
  followWhileShown(table.element, ["node", "panel"], () => table.mark(getState().node));
  return table.element;
}

/** Call now and whenever one of these changes, at the next frame, as long as an element is on the page. @param {HTMLElement} element @param {string[]} keys @param {() => void} call */
function followWhileShown(element, keys, call) {
  const stop = subscribe([...keys, "job"], () => (element.isConnected ? requestAnimationFrame(call) : stop()));
  requestAnimationFrame(call);
}
