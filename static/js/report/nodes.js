/** The table of all OSM intersections that the drive could or did find. */
import { medianError } from "../data/results.js";
import { el } from "../dom.js";
import { goTo } from "../map/details.js";
import { kindOfNode, NODE_OUTCOMES } from "../map/layers.js";
import { getState, subscribe } from "../state.js";
import { belowRow, outcomeColumn, sortedTable } from "./sorted_table.js";

/** @type {import("./sorted_table.js").Column[]} */
const COLUMNS = [
  outcomeColumn(
    "Found: an intersection of the map is assigned to it, one to one, within 10 m.",
    NODE_OUTCOMES,
    ({ kind }) => kind,
  ),
  {
    name: "Error",
    meaning: "Distance of the intersection of the map that is assigned to it, metres.",
    value: (node) => node.map_error_m,
    digits: 2,
    down: true,
  },
  { name: "Seen", meaning: "Detections that were matched to it.", value: (node) => node.detections, down: true },
  {
    name: "Median",
    meaning: "Median error of its true detections, metres; of all, where none is true.",
    value: (node) => node.median_m,
    digits: 2,
    down: true,
  },
  {
    name: "Missed",
    meaning: "Keyframes that had it in the relevant zone without a detection, of all that had it there.",
    value: (node) => node.keyframes_missed,
    text: (node) => `${node.keyframes_missed}/${node.keyframes_in_zone}`,
    down: true,
  },
];

/** @param {import("../data/results.js").Result} result */
export function nodeTable(result) {
  const places = new Map(result.nodes.map((node) => [node.properties.osm_id, node]));
  const table = sortedTable(COLUMNS, {
    keyOf: ({ osm_id }) => String(osm_id),
    below: (node) => belowRow({ ...node, names: `${node.names ?? "Node"} ` }, el("span.number", ` ${node.osm_id}`)),
    onChoose: ({ osm_id }) => {
      const item = places.get(osm_id);
      if (item) goTo({ kind: "node", item });
    },
  });
  table.show(
    result.report.nodes.map((/** @type {any} */ node) => ({
      ...node,
      kind: kindOfNode({ properties: node }),
      median_m: medianError(result, node),
    })),
  );
  const mark = () => table.mark(getState().node);
  const stop = subscribe(["node", "panel"], () => (table.element.isConnected ? requestAnimationFrame(mark) : stop()));
  requestAnimationFrame(mark);
  return el("div.osm-nodes", table.element);
}
