/**
 * The box at the right of the map: layers to switch, with their signs and counts.
 * @module map/legend
 */

import { el, fill, formatCount, icon } from "../dom.js";
import { Control, DomEvent } from "../leaflet.js";
import { getState, setState, subscribe } from "../state.js";
import { LAYERS, layersOn } from "./layers.js";
import { signIcon } from "./symbols.js";
import { tileBox } from "./tiles.js";

const OPEN_KEY = "interloc.legend";
const WIDE_PX = 640; // on a narrower map the legend is folded: it would hide the half of it

/**
 * @param {any} map
 * @returns {{show: (result: import("../data/results.js").Result|null) => void}}
 */
export function addLegend(map) {
  const box = el("section", { class: "legend", hidden: true, "aria-label": "Layers of the map" });
  const control = new Control({ position: "topright" });
  control.onAdd = () => {
    DomEvent.disableClickPropagation(box);
    DomEvent.disableScrollPropagation(box);
    return box;
  };
  control.addTo(map);

  /** @type {import("../data/results.js").Result|null} */
  let result = null;
  const update = () => {
    box.hidden = !result;
    if (!result) return;
    const shown = result;
    const on = layersOn(getState().layers);
    const focused = box.contains(document.activeElement) ? document.activeElement?.id : null;
    const rows = LAYERS.map((layer) => ({ layer, count: layer.count(shown) })).filter(({ count }) => count !== 0);
    const groups = [...new Set(rows.map(({ layer }) => layer.group))];
    fill(
      box,
      el(
        "details",
        { open: isWide() && localStorage.getItem(OPEN_KEY) !== "no" },
        el(
          "summary",
          {
            onClick: (/** @type {any} */ e) =>
              localStorage.setItem(OPEN_KEY, e.currentTarget.parentElement.open ? "no" : "yes"),
          },
          icon("layers"),
          "Layers",
        ),
        groups.map((group) =>
          el(
            "fieldset",
            {},
            el("legend", { class: "unseen" }, group),
            rows.filter(({ layer }) => layer.group === group).map(({ layer, count }) => row(layer, count, on)),
            group === "Base" && on.has("tiles") && tileBox(),
          ),
        ),
      ),
    );
    if (focused) document.getElementById(focused)?.focus();
  };
  const isWide = () => map.getSize().x >= WIDE_PX;
  let wasWide = true;
  map.on("resize", () => {
    if (isWide() === wasWide) return;
    wasWide = !wasWide;
    update();
  });
  subscribe(["layers"], update);
  return {
    show(next) {
      result = next;
      update();
    },
  };
}

/** @param {import("./layers.js").LayerKind} layer @param {number|null} count @param {Set<string>} on */
function row(layer, count, on) {
  const id = `layer-${layer.id}`;
  return el(
    "label",
    { title: layer.hint, htmlFor: id },
    el("input", {
      type: "checkbox",
      id,
      checked: on.has(layer.id),
      onChange: (/** @type {any} */ e) => switchLayer(layer.id, e.target.checked),
    }),
    layer.sign ? signIcon(layer.sign) : el("span", { class: `sign line ${layer.line}`, "aria-hidden": "true" }),
    el("span", { class: "grow" }, layer.title),
    count !== null && el("span", { class: "number quiet" }, formatCount(count)),
  );
}

/** @param {string} id @param {boolean} isOn */
export function switchLayer(id, isOn) {
  const on = layersOn(getState().layers);
  if (isOn) on.add(id);
  else on.delete(id);
  const usual = layersOn(null);
  const same = on.size === usual.size && [...on].every((each) => usual.has(each));
  setState({ layers: same ? null : LAYERS.map((each) => each.id).filter((each) => on.has(each)) });
}
