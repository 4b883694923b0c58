/** The result: its job, and the report: how many intersections are right, how many of the map were found. */
import { download } from "../api.js";
import { figure, resultSection as section } from "../controls.js";
import { el, fill, formatDate, formatMetres, formatPercent, plural } from "../dom.js";
import { mountJob } from "../job/panel.js";
import { onResult, shown } from "../map/shown.js";
import { showError } from "../messages.js";
import { getState, subscribe } from "../state.js";
import { intersectionList, nodeTable } from "./tables.js";

/** @import { Result } from "../data/results.js" */

const D = "5.0";
const DETECTIONS_HINT =
  "Every detection at every keyframe, against the nearest OSM intersection of its region of interest; true within D.";

/** @param {HTMLElement} container */
export function mount(container) {
  const job = el("div");
  const report = el("div");
  fill(container, job, report);
  mountJob(job);
  const update = () => {
    const { result } = shown;
    report.hidden = result?.job.id !== getState().job;
    if (report.hidden || !result) fill(report);
    else if (result.report) fill(report, el("div.section.stack", sections(result, result.report)));
    else fill(report, section("Intersections", intersectionList(result)));
  };
  subscribe(["job"], update);
  onResult(update);
}

/** @param {Result} result @param {any} report */
function sections(result, report) {
  const { osm, policy, tolerance_m, warnings } = report;
  const source = `Scored against ${osm.source}${osm.date ? ` of ${formatDate(osm.date)}` : ""}; ${plural(osm.nodes, "intersection")}`;
  const merged = tolerance_m ? ` (merged within ${tolerance_m} m)` : "";
  const open = () => download(`jobs/${result.job.id}/report?format=html`, "report.html").catch(showError);
  return [
    el("p.small", `${source} under policy `, el("b", policy), merged, "."),
    warnings.map((/** @type {string} */ text) => el("p.note.warning", text)),
    mapFigures(report.map_level),
    el("section.group", el("h3", "Intersections"), intersectionList(result)),
    el("details.group.osm-nodes", el("summary", "OSM intersections"), nodeTable(result)),
    el("details.group", el("summary", "Detections, the paper’s measure"), [
      el("p.small", DETECTIONS_HINT),
      el("div.tiles-row", [
        figure(formatMetres(report.ace_m), "mean error (ACE)", `median ${formatMetres(report.median_m)}`),
        figure(formatPercent(report.precision[D]), "precision", "D = 5 m"),
        figure(formatPercent(report.recall[D]), "recall", "D = 5 m"),
      ]),
      el("p.small", [
        `${report.nodes_found} of ${report.nodes_in_zone} OSM nodes have a detection within 5 m. Over D, and their errors: `,
        el("button.link", { onClick: open }, "the report"),
      ]),
    ]),
  ];
}

/** @param {any} level `map_level` of the report. */
function mapFigures(level) {
  const gate = `within ${level.gate_m ?? 10} m, one to one`;
  const found = level.nodes_in_zone - level.missed;
  const scored = level.true + level.false;
  return el("div.tiles-row.large", [
    scored ? figure(`${level.true} of ${scored}`, "intersections right", gate) : figure("none", "intersections found"),
    figure(`${found} of ${level.nodes_in_zone}`, "OSM nodes found", gate),
    figure(formatMetres(level.median_m), "median error", `at most ${formatMetres(level.max_m)}`),
  ]);
}
