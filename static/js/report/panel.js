/** The result: its job, and the report: how far off, how many right, how many missed; over D, per node, beside the paper, beside another job. */
import { getJson } from "../api.js";
import { figure, resultSection as section, table } from "../controls.js";
import { el, fill, formatCount, formatDate, formatMetres, formatPercent, plural } from "../dom.js";
import { mountJob } from "../job/panel.js";
import { serviceSwitch } from "../map/details.js";
import { onResult, shown } from "../map/shown.js";
import { getState, subscribe } from "../state.js";
import { barChart, lineChart } from "./chart.js";
import { intersectionList } from "./intersections.js";
import { nodeTable } from "./nodes.js";
import { at, curve, histogram, sequenceOf } from "./scores.js";

/** @import { Result } from "../data/results.js" */

const D = 5;
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
  const scores = at(report, D);
  const { map_level: level, osm } = report;
  const points = curve(report);
  const errors = result.matches.map((each) => each.error_m);
  const counts = el("p.small.number");
  const explain = (/** @type {number} */ d) => {
    const { tp, fp, fn } = at(report, d);
    const missed = `${formatCount(fn)} times a node in the relevant zone without a detection`;
    fill(counts, `${formatCount(tp)} true, ${formatCount(fp)} false; ${missed}.`);
  };
  explain(D);
  const source = `Scored against ${osm.source}${osm.date ? ` of ${formatDate(osm.date)}` : ""}; ${plural(osm.nodes, "intersection")}`;
  const merged = report.tolerance_m ? ` (merged within ${report.tolerance_m} m)` : "";
  const lines = [
    { name: "Precision", colour: "var(--tp)", points: points.map((p) => [p.d, p.precision]) },
    { name: "Recall", colour: "var(--fp)", dash: "6 3", points: points.map((p) => [p.d, p.recall]) },
    { name: "F1", colour: "var(--found)", dash: "2 3", points: points.map((p) => [p.d, p.f1]) },
  ];
  return [
    el("p.small", `${source} under policy `, el("b", report.policy), merged, "."),
    report.warnings.map((/** @type {string} */ text) => el("p.note.warning", text)),
    el("section.group", [
      el("h3", "The map"),
      mapFigures(level),
      serviceNote(result),
      el("h4", "Intersections"),
      intersectionList(result),
      el("h4", "OSM intersections"),
      nodeTable(result),
    ]),
    el("section.group", [
      el("h3", "Detections, the paper’s measure"),
      el("p.small", DETECTIONS_HINT),
      el("div.tiles-row", [
        figure(formatMetres(report.ace_m), "mean error (ACE)", `median ${formatMetres(report.median_m)}`),
        figure(formatPercent(scores.precision), "precision", `D = ${D} m`),
        figure(formatPercent(scores.recall), "recall", `D = ${D} m`),
      ]),
      el("p.small", `${report.nodes_found} of ${report.nodes_in_zone} OSM nodes have a detection within ${D} m.`),
      paperNote(result, report),
      el("h4", "Precision, recall and F1 over D"),
      lineChart(/** @type {any} */ (lines), { max: 10, mark: D, onMark: explain }),
      counts,
      el("h4", "Center errors"),
      barChart(histogram(errors, 0.5, 20), { width: 0.5, limit: report.ace_tp_threshold_m ?? D }),
    ]),
  ];
}

/** What service roads would change, or do. @param {Result} result */
function serviceNote(result) {
  const other = result.report.with_service;
  if (!other) return null;
  const isOn = getState().service;
  if (!isOn && other.map_line === result.report.map_line) return null;
  const text = isOn
    ? "Service roads count here; the detections below are scored without them. "
    : `With service roads too: ${other.map_line.replace(/ within [\d.]+ m/, "")}. `;
  return el("p.small.service", text, serviceSwitch(result));
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

/** The paper's figures, where the drive is one of its sequences. @param {Result} result @param {any} report */
function paperNote(result, report) {
  const sequence = sequenceOf(result.job.drive_name);
  if (!sequence) return null;
  const holder = el("div", { hidden: true });
  const show = (/** @type {any} */ answer) => {
    const paper = (answer.sequences ?? answer)[sequence];
    if (!paper) return;
    holder.hidden = false;
    const own = at(report, D);
    const rows = [
      ["This job", report.ace_m, own.precision, own.recall],
      ["Paper, RangeNet++ labels", paper.ace_m, paper.precision, paper.recall],
    ].map(([name, ace, ...shares]) => [name, formatMetres(ace), ...shares.map(formatPercent)]);
    const note = el("p.small", "At D = 5 m. The paper used other labels and another map, so its figures differ.");
    const figures = table(["", "ACE", "Precision", "Recall"], rows);
    fill(holder, section(`Beside the paper: sequence ${sequence}`, figures, note));
  };
  getJson("paper").then(show, () => {}); // an older server has no such figures; the report stands without them
  return holder;
}
