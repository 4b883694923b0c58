/**
 * The table of all OSM intersections that the drive could or did find; a row leads to its place on the map.
 * @module report/nodes
 */
import { el, fill } from "../dom.js";
import { goTo } from "../map/details.js";
import { kindOfNode } from "../map/layers.js";
import { signIcon } from "../map/symbols.js";
import { getState, setState, subscribe } from "../state.js";

const ORDER = { missed: 0, found: 1, outside: 2 };
const NAMES = { missed: "missed", found: "found", outside: "out of reach" };

/** @type {Array<{name: string, title: string, value: (node: any) => number, text: (node: any) => any}>} */
const COLUMNS = [
  {
    name: "",
    title: "Outcome: whether a true detection was matched to it",
    value: (n) => ORDER[/** @type {"found"} */ (n.kind)],
    text: (n) =>
      el(
        "span",
        { title: NAMES[/** @type {"found"} */ (n.kind)] },
        signIcon(n.kind),
        el("span", { class: "unseen" }, NAMES[/** @type {"found"} */ (n.kind)]),
      ),
  },
  {
    name: "OSM node",
    title: "Number of the node in OpenStreetMap",
    value: (n) => n.osm_id ?? 0,
    text: (n) => n.osm_id,
  },
  { name: "Seen", title: "Detections matched to it", value: (n) => n.detections, text: (n) => n.detections },
  {
    name: "Missed",
    title: "Keyframes that had it in the relevant zone without a detection",
    value: (n) => n.keyframes_missed,
    text: (n) => `${n.keyframes_missed}/${n.keyframes_in_zone}`,
  },
  {
    name: "Median",
    title: "Median error of the detections, metres",
    value: (n) => n.median_error_m ?? Infinity,
    text: (n) => n.median_error_m?.toFixed(2) ?? "–",
  },
  {
    name: "Map",
    title: "Error of the intersection on the map, metres",
    value: (n) => n.map_error_m ?? Infinity,
    text: (n) => n.map_error_m?.toFixed(2) ?? "–",
  },
];

/** @param {import("../data/results.js").Result} result */
export function nodeTable(result) {
  const places = new Map(result.nodes.map((node) => [node.properties.osm_id, node]));
  const rows = result.report.nodes.map((/** @type {any} */ node) => ({
    ...node,
    kind: kindOfNode({ lng: 0, lat: 0, properties: node }),
  }));
  let column = 0;
  let down = false;
  const body = el("tbody", {});
  const heads = COLUMNS.map(({ name, title }, i) =>
    el(
      "th",
      { scope: "col", title },
      el(
        "button",
        { type: "button", "aria-label": name ? `${name}: ${title}` : title, onClick: () => sort(i) },
        name,
        el("span", { "aria-hidden": "true" }),
      ),
    ),
  );
  /** @param {number} next */
  const sort = (next) => {
    down = next === column ? !down : next > 1;
    column = next;
    update();
  };
  const update = () => {
    const { value } = COLUMNS[column];
    rows.sort(
      (/** @type {any} */ a, /** @type {any} */ b) => (value(a) - value(b)) * (down ? -1 : 1) || a.osm_id - b.osm_id,
    );
    heads.forEach((head, i) => {
      head.setAttribute("aria-sort", i === column ? (down ? "descending" : "ascending") : "none");
      head.querySelector("span").textContent = i === column ? (down ? "▾" : "▴") : "";
    });
    fill(
      body,
      rows.map((/** @type {any} */ node) => {
        const go = () => {
          const item = places.get(node.osm_id);
          if (!item) return;
          setState({ node: node.osm_id });
          goTo({ kind: "node", item });
        };
        return el(
          "tr",
          {
            class: `can${node.osm_id === getState().node ? " is" : ""}`,
            dataset: { node: node.osm_id },
            tabIndex: 0,
            title: "Show it on the map",
            onClick: go,
            onKeydown: (/** @type {KeyboardEvent} */ e) =>
              (e.key === "Enter" || e.key === " ") && (e.preventDefault(), go()),
          },
          COLUMNS.map(({ text }) => el("td", {}, text(node))),
        );
      }),
    );
  };
  const mark = () => {
    for (const row of body.children) row.classList.toggle("is", row.dataset.node === String(getState().node));
    body.querySelector(".is")?.scrollIntoView({ block: "nearest" });
  };
  update();
  const stop = subscribe(["node", "panel"], () => {
    if (body.isConnected) requestAnimationFrame(mark);
    else stop();
  });
  requestAnimationFrame(mark);
  return el("div", { class: "scroll" }, el("table", {}, el("thead", {}, el("tr", {}, heads)), body));
}
