/** The box at the right of the map: layers to switch, with their signs and counts. */

import { el, fill, formatCount, icon } from "../dom.js";
import { getState, setState, subscribe } from "../state.js";
import { keep, recall } from "../storage.js";
import { addCorner } from "./corners.js";
import { LAYERS, layersOf, layersOn } from "./layers.js";
import { signIcon } from "./symbols.js";

/** @import { Result } from "../data/results.js" */

const OPEN_KEY = "interloc.legend";
/** Groups whose name is needed to read their rows; the others' names are for screen readers. */
const HEADED = new Set(["Intersections", "OSM intersections", "Detections"]);
const WIDE_PX = 640; // on a narrower map the legend is folded: it would hide the half of it

/** @param {any} map @returns {{show: (result: Result|null) => void}} */
export function addLegend(map) {
  const box = el("section.legend", { hidden: true, "aria-label": "Layers of the map" });
  addCorner(map, "topright", box);

  /** @type {Result|null} */
  let result = null;
  const update = () => {
    box.hidden = !result;
    if (!result) return;
    const shown = result;
    const on = layersOn(getState().layers);
    const rows = layersOf(shown);
    const groups = [...new Set(rows.map(({ layer }) => layer.group))];
    const remember = (/** @type {any} */ event) =>
      keep(OPEN_KEY, event.currentTarget.parentElement.open ? "no" : "yes");
    const fieldset = (/** @type {string} */ group) =>
      el("fieldset", [
        el("legend", { class: HEADED.has(group) ? "legend-group" : "unseen" }, group),
        rows.filter(({ layer }) => layer.group === group).map(({ layer, count }) => row(layer, count, on)),
      ]);
    const open = isWide() && recall(OPEN_KEY) !== "no";
    const summary = el("summary.row", { onClick: remember }, icon("layers"), "Layers");
    fill(box, el("details", { open }, summary, groups.map(fieldset)));
  };
  const isWide = () => map.getSize().x >= WIDE_PX;
  let wasWide = true;
  map.on("resize", () => {
    if (isWide() === wasWide) return;
    wasWide = !wasWide;
    update();
  });
  map.on("unload", subscribe(["layers"], update));
  return {
    show(next) {
      result = next;
      update();
    },
  };
}

/** @param {typeof LAYERS[0]} layer @param {number|null} count @param {Set<string>} on */
function row({ id, title, hint }, count, on) {
  const onChange = () => switchLayer(id, box.checked);
  const box = el("input", { type: "checkbox", id: `layer-${id}`, checked: on.has(id), onChange });
  return el("label", { title: hint, htmlFor: box.id }, [
    box,
    signIcon(id),
    el("span.grow", title),
    count !== null && el("span.number.quiet", formatCount(count)),
  ]);
}

/** @param {string} id @param {boolean} isOn */
export function switchLayer(id, isOn) {
  const on = layersOn(getState().layers);
  on[isOn ? "add" : "delete"](id);
  const usual = layersOn(null);
  const same = on.size === usual.size && [...on].every((each) => usual.has(each));
  setState({ layers: same ? null : LAYERS.map((each) => each.id).filter((each) => on.has(each)) });
}
