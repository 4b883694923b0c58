/** What other jobs of the drive found, beside the result that is shown: put together, and marked on the map. */
import { getJson } from "../api.js";
import { kindOfCompared, matchIntersections } from "../data/compared.js";
import { lists, titleOf } from "../data/lists.js";
import { place } from "../data/results.js";
import { el } from "../dom.js";
import { DivIcon, LayerGroup, Marker } from "../leaflet.js";
import { showError } from "../messages.js";
import { news } from "../news.js";
import { getState, subscribe } from "../state.js";
import { onResult, shown } from "./shown.js";
import { signIcon } from "./symbols.js";

/** @import { Compared } from "../data/compared.js" */
/** @typedef {{jobs: string[], items: Compared[]}} Comparison `jobs`: ids, the shown one first. */

/** @type {Comparison|null} */
let compared = null;
/** @type {ReturnType<typeof news<[Comparison|null]>>} */
const changes = news();

/** @param {(compared: Comparison|null) => void} call Called now and whenever other jobs are compared. */
export function onCompared(call) {
  changes.hear(call);
  call(compared);
}

/** @returns {Comparison|null} As far as it is loaded. */
export const getCompared = () => compared;

/** @returns {string[]} Ids of the jobs that the shown one is compared with. */
export function comparedJobs() {
  const { job, compare } = getState();
  return (compare ?? []).filter((each) => each !== job);
}

/** Load what is compared whenever that changes. */
export function followCompared() {
  let token = 0;
  const update = async () => {
    const mine = ++token;
    const { result } = shown;
    const others = comparedJobs();
    if (!result || !others.length) return set(null);
    if (compared?.jobs.join() === [result.job.id, ...others].join()) return set(compared);
    set(null);
    const path = result.local ? "files/intersections.local.json" : "layers/intersections";
    try {
      const layers = await Promise.all(others.map((id) => getJson(`jobs/${id}/${path}`)));
      if (mine !== token) return;
      const sets = [result.intersections, ...layers.map(({ features }) => features.map(place))];
      set({ jobs: [result.job.id, ...others], items: matchIntersections(sets, result.local) });
    } catch (error) {
      if (mine === token) showError(error);
    }
  };
  subscribe(["compare"], () => void update());
  subscribe(["panel"], () => compared && set(compared));
  onResult(() => void update());
}

/** The marks are those of the panel that compares. @param {Comparison|null} next */
function set(next) {
  if (!next && !compared) return;
  compared = next;
  if (shown.result) shown.result.compared = (getState().panel === "compare" && next?.items) || [];
  changes.tell(next);
}

/** The marks on a map. */
export class ComparedLayer {
  /** @param {any} map */
  constructor(map) {
    this.group = new LayerGroup().addTo(map);
  }

  /** @param {Set<string>} on Layers that are on. */
  show(on) {
    this.group.clearLayers();
    for (const item of shown.result?.compared ?? []) {
      const kind = kindOfCompared(item);
      if (!on.has(kind)) continue;
      const sign = signIcon(kind);
      sign.classList.add("beside");
      const icon = new DivIcon({ html: sign, className: "", iconSize: [34, 34] });
      const interactive = kind === "elsewhere"; // the others lie around an intersection that is to be clicked itself
      const mark = new Marker([item.lat, item.lng], { icon, interactive, keyboard: false, pane: "marks" });
      if (interactive) mark.bindTooltip(describe(item), { direction: "bottom", offset: [0, 14], className: "tip" });
      mark.addTo(this.group);
    }
  }
}

/** @param {Compared} item */
function describe({ found }) {
  const finders = (compared?.jobs ?? []).filter((_, i) => found[i]);
  const names = finders.map((id) => {
    const job = lists.jobs.find((each) => each.id === id);
    return job ? titleOf(job) : id;
  });
  return el("div", el("strong", "Not found by this job"), el("br"), `Found by ${names.join("; ")}`);
}
