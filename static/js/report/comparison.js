/** The panel that puts jobs of one drive side by side, as the service compares them. */
import { getConfig, getJson } from "../api.js";
import { busy, table } from "../controls.js";
import { lists, onListsChange, titleOf } from "../data/lists.js";
import { el, fill, formatMetres, formatPercent, plural } from "../dom.js";
import { runAgain } from "../job/panel.js";
import { jobName } from "../job/words.js";
import { goToNode } from "../map/details.js";
import { NODE_OUTCOMES } from "../map/layers.js";
import { signIcon } from "../map/symbols.js";
import { problemNote } from "../messages.js";
import { getState, setState, subscribe } from "../state.js";

/** The figures that are shown, and what is better: more (1), less (-1). */
const FIGURES = /** @type {Record<string, number>} */ ({
  ...{ map_right: 1, map_wrong: -1, map_nodes_found: 1, map_median_m: -1 },
  ...{ ace_m: -1, median_m: -1, precision_at_5: 1, recall_at_5: 1, f1_at_5: 1, nodes_found: 1 },
});

/** @param {HTMLElement} container */
export function mount(container) {
  const head = el("div.stack-s");
  const choice = el("fieldset.others.stack-s");
  const holder = el("div.stack-s");
  let token = 0;
  fill(container, el("div.stack", head, choice, holder));

  const others = () => (getState().compare ?? []).filter((id) => id !== getState().job);
  const showJobs = () => {
    const job = lists.jobs.find(({ id }) => id === getState().job);
    if (!job)
      return fill(head, lists.isLoaded ? el("p.quiet", "Choose a job from the list of drives.") : busy("Loading…"));
    const isScored = Boolean(job.summary?.report);
    const isOther = (/** @type {any} */ each) => each.drive_id === job.drive_id && each !== job && each.summary?.report;
    const scored = isScored ? lists.jobs.filter(isOther) : [];
    const missing = isScored ? "The drive has no other job with a map yet" : "This job has not been scored";
    const none = !scored.length && el("p.quiet", `${missing}: run the drive again, with a map, to compare.`);
    fill(
      head,
      el("h2.cut", job.drive_name),
      el("p.small", "This job: ", titleOf(job)),
      none,
      none && el("div.row", runAgain(job)),
    );
    const chosen = others();
    const isFull = chosen.length >= getConfig().max_compared_jobs - 1;
    const row = (/** @type {any} */ each) => {
      const checked = chosen.includes(each.id);
      const next = checked ? chosen.filter((id) => id !== each.id) : [...chosen, each.id];
      const onChange = () => setState({ compare: next.length ? next : null });
      const props = { id: `compare-${each.id}`, checked, disabled: !checked && isFull, onChange };
      return el("label.check", el("input", { type: "checkbox", ...props }), el("span", jobName(each)));
    };
    choice.hidden = !scored.length;
    fill(choice, el("legend.field-name", "With other jobs of this drive"), scored.map(row));
  };
  const showCompared = async () => {
    const mine = ++token;
    const ids = [getState().job, ...others()];
    if (getState().panel !== "compare" || ids.length < 2) return fill(holder);
    fill(holder, busy("Comparing…"));
    const compared = await getJson(`compare?jobs=${ids.join()}`).catch((error) => ({ error }));
    if (mine === token) fill(holder, compared.error ? problemNote(compared.error) : comparison(compared));
  };
  onListsChange(showJobs);
  subscribe(["job", "compare", "panel"], () => (showJobs(), void showCompared()));
  showJobs();
  void showCompared();
}

/** A table with a column for each job. @param {string} first @param {string[]} names @param {any[][]} rows */
function columns(first, names, rows) {
  const made = table([first, ...names], rows);
  made.querySelectorAll("th")[1].append(el("small", "this job"));
  return el("div.wide-table", { tabIndex: 0, role: "group", "aria-label": first }, made);
}

/** @param {any} compared As the service answers. */
function comparison({ names, figures, inputs, settings, nodes, warnings, found_by_all, missed_by_all }) {
  const row = (/** @type {any} */ { name, values }) => [
    el("code", name),
    ...values.map((/** @type {any} */ value) => String(value ?? "–")),
  ];
  const own = [...inputs, ...settings.filter((/** @type {any} */ each) => each.is_own)].map(row);
  const ofPresets = settings.filter((/** @type {any} */ each) => !each.is_own).map(row);
  const summary = `${plural(ofPresets.length, "setting differs", "settings differ")} by the presets`;
  const moved = nodes.map((/** @type {any} */ { osm_id, outcomes }) => [
    el("button.link", { onClick: () => goToNode(osm_id) }, osm_id),
    ...outcomes.map((/** @type {"found"|"missed"|"outside"} */ each) => [signIcon(each), ` ${NODE_OUTCOMES[each]}`]),
  ]);
  const each = names.length === 2 ? "both" : "all";
  return [
    warnings.map((/** @type {string} */ warning) => el("p.note.warning", warning)),
    columns("Figure", names, scores(figures, !warnings.length)),
    el("h4", "What was asked for"),
    own.length > 0 && columns("Setting", names, own),
    ofPresets.length > 0 && el("details", el("summary", summary), columns("Setting", names, ofPresets)),
    !own.length && !ofPresets.length && el("p.small", "The same: labels, georeference and all settings."),
    el("h4", "OSM intersections with another outcome"),
    nodes.length
      ? columns("OSM node", names, moved)
      : el("p.small", `None: ${each} found ${found_by_all} and missed ${missed_by_all}.`),
  ];
}

/** @param {{name: string, title: string, values: (number|null)[]}[]} figures @param {boolean} isFair */
function scores(figures, isFair) {
  const right = figures.find(({ name }) => name === "map_right")?.values ?? [];
  return figures
    .filter(({ name }) => name in FIGURES)
    .map(({ name, title, values }) => {
      const text = name.endsWith("_m") ? formatMetres : name.endsWith("_at_5") ? formatPercent : String;
      // A job that found nothing is the best at nothing: without intersections none is wrong.
      const gains = values.map((value, i) => (value === null || !right[i] ? -Infinity : value * FIGURES[name]));
      const best = Math.max(...gains);
      const isBetter = (/** @type {number} */ i) => isFair && gains[i] === best && gains.some((each) => each !== best);
      const cells = values.map((value, i) =>
        el("td", { class: isBetter(i) ? "better" : "" }, text(/** @type {any} */ (value))),
      );
      return [`${title[0].toUpperCase()}${title.slice(1).replace(" [m]", "")}`, ...cells];
    });
}
