/**
 * Two jobs of one drive side by side.
 * @module report/comparison
 */
import { getJson } from "../api.js";
import { lists } from "../data/lists.js";
import { el, fill, formatMetres, formatPercent, plural } from "../dom.js";
import { goTo } from "../map/details.js";
import { shown } from "../map/shown.js";
import { signIcon } from "../map/symbols.js";
import { jobName } from "../shell/header.js";
import { problemNote } from "../shell/messages.js";
import { at } from "./scores.js";

/** @param {import("../data/results.js").Result} result */
export function comparison(result) {
  const others = lists.jobs.filter(
    (job) =>
      job.drive_id === result.job.drive_id && job.id !== result.job.id && job.state === "successful" && job.request.osm,
  );
  if (!others.length) return null;
  const holder = el("div", {});
  const choice = el(
    "select",
    { "aria-label": "Other job", onChange: () => void show() },
    el("option", { value: "" }, "Choose another job of this drive"),
    others.map((job) => el("option", { value: job.id }, jobName(job))),
  );
  const show = async () => {
    fill(holder);
    if (!choice.value) return;
    try {
      const [compared, other] = await Promise.all([
        getJson(`compare?jobs=${result.job.id},${choice.value}`),
        getJson(`jobs/${choice.value}/report`),
      ]);
      fill(holder, table(result.report, other), differences(compared));
    } catch (error) {
      fill(holder, problemNote(error));
    }
  };
  return el("section", { class: "section" }, el("h3", {}, "Compare"), el("div", { class: "stack-s" }, choice, holder));
}

/** @param {any} a @param {any} b */
function table(a, b) {
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
  return el(
    "table",
    {},
    el(
      "thead",
      {},
      el(
        "tr",
        {},
        ["", "This job", "Other job"].map((name) => el("th", { scope: "col" }, name)),
      ),
    ),
    el(
      "tbody",
      {},
      rows.map(([name, x, y, text, more]) => {
        const sign = x === null || y === null ? 0 : Math.sign(x - y) * more;
        return el(
          "tr",
          {},
          el("td", {}, name),
          el("td", { class: sign > 0 ? "better" : "" }, text(x)),
          el("td", { class: sign < 0 ? "better" : "" }, text(y)),
        );
      }),
    ),
  );
}

/** @param {any} compared */
function differences(compared) {
  const { settings, nodes } = compared;
  return [
    compared.warnings.map((/** @type {string} */ text) => el("p", { class: "note warning" }, text)),
    settings.length
      ? el(
          "details",
          {},
          el("summary", {}, plural(settings.length, "setting differs", "settings differ")),
          headed(
            ["Setting", "This job", "Other job"],
            settings.map((/** @type {any} */ each) => [
              el("code", {}, each.name),
              ...each.values.map((/** @type {any} */ value) => (value === null ? "–" : String(value))),
            ]),
          ),
        )
      : el("p", { class: "small" }, "Both ran with the same settings."),
    el("h4", {}, "OSM intersections with another outcome"),
    nodes.length
      ? headed(
          ["OSM node", "This job", "Other job"],
          nodes.map((/** @type {any} */ node) => [
            el("button", { class: "link", onClick: () => show(node) }, node.osm_id),
            ...node.outcomes.map(outcome),
          ]),
        )
      : el("p", { class: "small" }, `None: both found ${compared.found_by_all} and missed ${compared.missed_by_all}.`),
  ];
}

/** @param {string} name */
function outcome(name) {
  return [signIcon(name), ` ${name === "outside" ? "out of reach" : name}`];
}

/** @param {any} node */
function show(node) {
  const item = shown.result?.nodes.find((each) => each.properties.osm_id === node.osm_id);
  if (item) goTo({ kind: "node", item });
}

/** @param {string[]} heads @param {any[][]} rows */
function headed(heads, rows) {
  return el(
    "table",
    {},
    el(
      "thead",
      {},
      el(
        "tr",
        {},
        heads.map((name) => el("th", { scope: "col" }, name)),
      ),
    ),
    el(
      "tbody",
      {},
      rows.map((cells) =>
        el(
          "tr",
          {},
          cells.map((each) => el("td", {}, each)),
        ),
      ),
    ),
  );
}
