/** The panel that puts jobs of one drive side by side. */
import { getConfig, getJson } from "../api.js";
import { busy, select, table } from "../controls.js";
import { kindOfCompared } from "../data/compared.js";
import { lists, onListsChange, titleOf } from "../data/lists.js";
import { el, fill, formatMetres, formatPercent, plural } from "../dom.js";
import { jobName } from "../job/words.js";
import { comparedJobs, getCompared, onCompared } from "../map/compared.js";
import { goTo } from "../map/details.js";
import { NODE_OUTCOMES } from "../map/layers.js";
import { onResult, shown } from "../map/shown.js";
import { signIcon } from "../map/symbols.js";
import { problemNote } from "../messages.js";
import { getState, setState, subscribe } from "../state.js";
import { lineChart, lineKey } from "./chart.js";
import { at, curve } from "./scores.js";

/** @import { Comparison } from "../map/compared.js" */

const COLOURS = ["tp", "fp", "found", "missed", "warn", "accent", "ink", "outside"].map((name) => `var(--${name})`);
const DASHES = [undefined, "7 3", "2 3", "9 3 2 3", "4 2", "12 4", "2 2", "6 2 2 2"];
const MEASURES = { f1: "F1", precision: "Precision", recall: "Recall" };

/** Of the report that is shown: jobs to choose from, what is compared, intersections that differ. */
let showJobs = () => {};
let showCompared = () => {};
/** @type {(compared: Comparison|null) => void} */
let showPlaces = () => {};
onListsChange(() => showJobs());
subscribe(["compare"], () => (showJobs(), showCompared()));
onCompared((compared) => showPlaces(compared));

/** @param {HTMLElement} container */
export function mount(container) {
  onResult((result) => {
    showJobs = showCompared = showPlaces = () => {};
    const isLoading = !result && lists.jobs.some(({ id, state }) => id === getState().job && state === "successful");
    if (isLoading) return fill(container, busy("Loading the result…"));
    if (!result?.report) {
      const text = "Jobs of one drive that were scored are compared here: run it again with another map or settings.";
      return fill(container, el("p.quiet", text));
    }
    fill(container, el("div.stack", comparison(result)));
  });
}

/** @param {import("../data/results.js").Result} result */
function comparison({ job, report }) {
  const choice = el("fieldset.others.stack-s");
  const holder = el("div.stack-s");
  const places = el("div.stack-s");
  const alone = el("p.quiet", "The drive has no other job with a map yet: run it again to compare.");
  /** @type {string[]} */
  let names = [];
  let token = 0;

  showJobs = () => {
    const ofDrive = lists.jobs.filter((each) => each.drive_id === job.drive_id && each.id !== job.id);
    const others = ofDrive.filter(({ state, summary }) => state === "successful" && summary?.report);
    alone.hidden = others.length > 0;
    choice.hidden = !others.length;
    const chosen = comparedJobs();
    const maxOthers = getConfig().max_compared_jobs - 1;
    const row = (/** @type {any} */ each) => {
      const isChosen = chosen.includes(each.id);
      const onChange = () => {
        const next = isChosen ? chosen.filter((id) => id !== each.id) : chosen.concat(each.id).slice(0, maxOthers);
        setState({ compare: next.length ? next : null });
      };
      const disabled = !isChosen && chosen.length >= maxOthers;
      const box = el("input", { type: "checkbox", id: `compare-${each.id}`, checked: isChosen, disabled, onChange });
      return el("label.check", box, el("span", jobName(each)));
    };
    fill(choice, el("legend.field-name", "With other jobs of this drive"), others.map(row));
  };

  showCompared = async () => {
    const mine = ++token;
    const ids = [job.id, ...comparedJobs()];
    const { service } = getState();
    fill(places);
    if (ids.length < 2) return fill(holder);
    fill(holder, busy("Comparing…"));
    try {
      const [compared, ...others] = await Promise.all([
        getJson(`compare?jobs=${ids.map(encodeURIComponent).join(",")}`),
        ...ids.slice(1).map((id) => getJson(`jobs/${encodeURIComponent(id)}/report`)),
      ]);
      if (mine !== token) return;
      names = compared.names;
      const reports = [
        report,
        ...others.map((each) => (service && each.with_service ? { ...each, ...each.with_service } : each)),
      ];
      const jobs = ids.map((id) => lists.jobs.find((each) => each.id === id));
      fill(holder, scores(names, reports), curves(names, reports), differences(names, jobs, compared));
      showPlaces(getCompared());
    } catch (error) {
      if (mine === token) fill(holder, problemNote(error));
    }
  };

  showPlaces = (compared) => {
    fill(places);
    const isKnown = compared !== null && compared.jobs[0] === job.id && compared.jobs.length === names.length;
    if (isKnown) fill(places, placesOf(names, compared));
  };

  showJobs();
  void showCompared();
  return [el("h2.cut", job.drive_name), el("p.small", "This job: ", titleOf(job)), alone, choice, holder, places];
}

/** A table with a column for each job. @param {string} first @param {string[]} names @param {any[][]} rows */
function columns(first, names, rows) {
  const made = table([first, ...names], rows);
  made.querySelectorAll("thead th").forEach((head, i) => {
    if (i) head.append(lineKey(COLOURS[i - 1], DASHES[i - 1]), i === 1 ? el("small", "this job") : "");
  });
  return el("div.wide-table", { tabIndex: 0, role: "group", "aria-label": first }, made);
}

/** @param {string[]} names @param {any[]} reports */
function scores(names, reports) {
  const of = (/** @type {(report: any) => number|null} */ value) => reports.map(value);
  /** @type {Array<[string, Array<number|null>, (value: any) => string, number]>} The last: 1 where more is better. */
  const rows = [
    ["Intersections right", of((r) => r.map_level.true), String, 1],
    ["Intersections wrong", of((r) => r.map_level.false), String, -1],
    ["OSM nodes found", of((r) => r.map_level.nodes_in_zone - r.map_level.missed), String, 1],
    ["Median error of intersections", of((r) => r.map_level.median_m), formatMetres, -1],
    ["Mean error of detections (ACE)", of((r) => r.ace_m), formatMetres, -1],
    ["Median error of detections", of((r) => r.median_m), formatMetres, -1],
    ["Precision of detections, D = 5 m", of((r) => at(r, 5).precision), formatPercent, 1],
    ["Recall of detections, D = 5 m", of((r) => at(r, 5).recall), formatPercent, 1],
    ["F1 of detections, D = 5 m", of((r) => at(r, 5).f1), formatPercent, 1],
    ["OSM nodes with a detection within 5 m", of((r) => r.nodes_found), String, 1],
  ];
  const cells = rows.map(([name, values, text, more]) => {
    // A job that found nothing is the best at nothing: without intersections none is wrong.
    const gains = values.map((each, i) => (each === null || !reports[i].map_level.true ? null : each * more));
    const known = gains.filter((each) => each !== null);
    const best = Math.max(...known);
    const differ = known.length < values.length || known.some((each) => each !== best);
    const isBetter = (/** @type {number} */ i) => differ && gains[i] === best;
    return [name, ...values.map((value, i) => el("td", { class: isBetter(i) ? "better" : "" }, text(value)))];
  });
  return columns("Figure", names, cells);
}

/** @param {string[]} names @param {any[]} reports */
function curves(names, reports) {
  const holder = el("div");
  const show = (/** @type {string} */ measure) => {
    const lines = reports.map((report, i) => ({
      name: names[i],
      colour: COLOURS[i],
      dash: DASHES[i],
      points: curve(report).map((each) => [each.d, /** @type {any} */ (each)[measure]]),
    }));
    fill(holder, lineChart(/** @type {any} */ (lines), { max: 10, mark: 5, onMark: () => {} }));
  };
  show("f1");
  return [el("h4.spread", "Over D", select(MEASURES, "f1", show, "Measure")), holder];
}

/** @param {string[]} names @param {any[]} jobs @param {any} compared */
function differences(names, jobs, { settings, nodes, warnings, found_by_all, missed_by_all }) {
  const row = (/** @type {any} */ { name, values }) => [
    el("code", name),
    ...values.map((/** @type {any} */ value) => String(value ?? "–")),
  ];
  const own = [...choicesThatDiffer(jobs), ...settings.filter((/** @type {any} */ each) => each.is_own).map(row)];
  const ofPresets = settings.filter((/** @type {any} */ each) => !each.is_own).map(row);
  const summary = `${plural(ofPresets.length, "setting differs", "settings differ")} by the presets`;
  const moved = nodes.map((/** @type {any} */ node) => [
    el("button.link", { onClick: () => showNode(node) }, node.osm_id),
    ...node.outcomes.map((/** @type {string} */ name) =>
      outcome(name, /** @type {any} */ (NODE_OUTCOMES)[name], names.length),
    ),
  ]);
  const each = names.length === 2 ? "both" : "all";
  return [
    warnings.map((/** @type {string} */ warning) => el("p.note.warning", warning)),
    el("h4", "What was asked for"),
    own.length > 0 && columns("Setting", names, own),
    ofPresets.length > 0 && el("details", el("summary", summary), columns("Setting", names, ofPresets)),
    !own.length && !ofPresets.length && el("p.small", "The same: map, labels and all settings."),
    el("h4", "OSM intersections with another outcome"),
    nodes.length
      ? columns("OSM node", names, moved)
      : el("p.small", `None: ${each} found ${found_by_all} and missed ${missed_by_all}.`),
  ];
}

/** @param {any[]} jobs undefined where a job is not in the lists. */
function choicesThatDiffer(jobs) {
  if (!jobs.every(Boolean)) return [];
  const requests = jobs.map((each) => each.request);
  /** @type {Array<[string, any[]]>} */
  const rows = [
    ["Labels", requests.map(({ labels }) => labels ?? "labels")],
    ["Map", requests.map(({ osm }) => osm?.file ?? "Overpass")],
    ["Policy", requests.map(({ policy }) => policy)],
    ["Georeference", requests.map(({ georeference }) => (georeference === "map" ? "roads of the map" : "drive"))],
  ];
  return rows.filter(([, values]) => new Set(values).size > 1).map(([name, values]) => [name, ...values]);
}

/** @param {string} sign @param {string} text Only read aloud where there are many columns. @param {number} count */
function outcome(sign, text, count) {
  return el("span", { title: text }, signIcon(sign), el("span", { class: count > 2 ? "unseen" : "" }, ` ${text}`));
}

/** @param {string[]} names @param {Comparison} compared */
function placesOf(names, { items }) {
  const differing = items.filter((each) => kindOfCompared(each) !== "shared");
  const count = (/** @type {string} */ kind) => items.filter((each) => kindOfCompared(each) === kind).length;
  const parts = [
    `${count("shared")} found by ${names.length === 2 ? "both" : `all ${names.length}`}`,
    `${count("here")} by this job${names.length === 2 ? " only" : " but not by all"}`,
    `${count("elsewhere")} not by this job`,
  ];
  let others = 0;
  const nameOf = (/** @type {any} */ { found, properties }) =>
    properties.names ?? (found[0] ? `No. ${properties.id}` : `Other ${(others += 1)}`);
  const rows = differing.map((item) => [
    el("button.link", { onClick: () => showPlace(item) }, nameOf(item)),
    ...item.found.map((isFound, i) =>
      isFound ? outcome(item.outcomes[i] ?? "unscored", item.outcomes[i] ?? "found", names.length) : "–",
    ),
  ]);
  return [
    el("h4", "Intersections of the map"),
    el("p.small", `${parts.join("; ")}. Within 10 m they are the same.`),
    rows.length > 0 && columns("Intersection", names, rows),
  ];
}

/** @param {import("../data/compared.js").Compared} item */
function showPlace(item) {
  const own = shown.result?.intersections.find((each) => each.properties.id === item.properties.id);
  if (item.found[0] && own) return goTo({ kind: "intersection", item: own });
  shown.map?.setView([item.lat, item.lng], Math.max(shown.map.getZoom(), shown.result?.local ? 2.5 : 18.5));
}

/** @param {any} node */
function showNode(node) {
  const item = shown.result?.nodes.find((each) => String(each.properties.osm_id) === node.osm_id);
  if (item) goTo({ kind: "node", item });
}
