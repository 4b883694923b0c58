/**
 * Two jobs of one drive side by side.
 * @module report/comparison
 */
import { getJson } from "../api.js";
import { resultSection, table } from "../controls.js";
import { lists } from "../data/lists.js";
import { el, fill, formatMetres, formatPercent, plural } from "../dom.js";
import { jobName } from "../job/words.js";
import { goTo } from "../map/details.js";
import { shown } from "../map/shown.js";
import { signIcon } from "../map/symbols.js";
import { problemNote } from "../messages.js";
import { at } from "./scores.js";

/** @param {import("../data/results.js").Result} result */
export function comparison({ job, report }) {
  const isOther = (/** @type {any} */ each) =>
    each.drive_id === job.drive_id && each.id !== job.id && each.state === "successful" && each.request.osm;
  const others = lists.jobs.filter(isOther);
  if (!others.length) return null;
  const holder = el("div", {});
  const options = others.map((each) => el("option", { value: each.id }, jobName(each)));
  const first = el("option", { value: "" }, "Choose another job of this drive");
  const choice = el("select", { "aria-label": "Other job", onChange: () => void show() }, first, options);
  const show = async () => {
    fill(holder);
    if (!choice.value) return;
    try {
      const [compared, other] = await Promise.all([
        getJson(`compare?jobs=${job.id},${choice.value}`),
        getJson(`jobs/${choice.value}/report`),
      ]);
      fill(holder, scores(report, other), differences(compared));
    } catch (error) {
      fill(holder, problemNote(error));
    }
  };
  return resultSection("Compare", el("div", { class: "stack-s" }, choice, holder));
}

/** @param {any} a @param {any} b */
function scores(a, b) {
  const [one, two] = [at(a, 5), at(b, 5)];
  /** @type {Array<[string, number|null, number|null, (value: any) => string, number]>} The last: 1 where more is better. */
  const rows = [
    ["Mean error (ACE)", a.ace_m, b.ace_m, formatMetres, -1],
    ["Median error", a.median_m, b.median_m, formatMetres, -1],
    ["Precision, D = 5 m", one.precision, two.precision, formatPercent, 1],
    ["Recall, D = 5 m", one.recall, two.recall, formatPercent, 1],
    ["F1, D = 5 m", one.f1, two.f1, formatPercent, 1],
    ["OSM nodes found", a.nodes_found, b.nodes_found, String, 1],
    ["Precision of the map", a.map_level.precision, b.map_level.precision, formatPercent, 1],
    ["Recall of the map", a.map_level.recall, b.map_level.recall, formatPercent, 1],
  ];
  const cells = rows.map(([name, x, y, text, more]) => {
    const sign = x === null || y === null ? 0 : Math.sign(x - y) * more;
    const cell = (/** @type {number|null} */ value, /** @type {boolean} */ isBetter) =>
      el("td", { class: isBetter ? "better" : "" }, text(value));
    return [name, cell(x, sign > 0), cell(y, sign < 0)];
  });
  return table(["", "This job", "Other job"], cells);
}

/** @param {any} compared */
function differences({ settings, nodes, warnings, found_by_all, missed_by_all }) {
  const text = (/** @type {any} */ value) => (value === null ? "–" : String(value));
  const changed = settings.map((/** @type {any} */ { name, values }) => [el("code", {}, name), ...values.map(text)]);
  const moved = nodes.map((/** @type {any} */ node) => [
    el("button", { class: "link", onClick: () => showNode(node) }, node.osm_id),
    ...node.outcomes.map(outcome),
  ]);
  const summary = el("summary", {}, plural(settings.length, "setting differs", "settings differ"));
  return [
    warnings.map((/** @type {string} */ warning) => el("p", { class: "note warning" }, warning)),
    settings.length
      ? el("details", {}, summary, table(["Setting", "This job", "Other job"], changed))
      : el("p", { class: "small" }, "Both ran with the same settings."),
    el("h4", {}, "OSM intersections with another outcome"),
    nodes.length
      ? table(["OSM node", "This job", "Other job"], moved)
      : el("p", { class: "small" }, `None: both found ${found_by_all} and missed ${missed_by_all}.`),
  ];
}

/** @param {string} name */
function outcome(name) {
  return [signIcon(name), ` ${name === "outside" ? "out of reach" : name}`];
}

/** @param {any} node */
function showNode(node) {
  const item = shown.result?.nodes.find((each) => each.properties.osm_id === node.osm_id);
  if (item) goTo({ kind: "node", item });
}
