/** The measure: a click sets a point, the sum of the distances is at the last one, Escape ends. */
import { distanceM } from "../data/frame.js";
import { announce, el, formatMetres, isTyping } from "../dom.js";
import { CircleMarker, LayerGroup, Polyline, Tooltip } from "../leaflet.js";
import { addButton } from "./corners.js";
import { shown } from "./shown.js";

/** Ends or begins the measure of the map that is shown. @type {() => void} */
let toggle = () => {};

/** @param {any} map @param {boolean} local */
export function addMeasure(map, local) {
  const label = "Measure distances";
  const title = `${label} (m): click points on the map, Backspace takes the last one back, Escape ends`;
  const button = addButton(map, "ruler", label, () => toggle(), title);
  button.setAttribute("aria-pressed", "false");

  const look = { interactive: false, pane: "marks" };
  const drawing = new LayerGroup();
  const beside = { permanent: true, direction: "right", offset: [10, 0], opacity: 1 };
  const sum = new Tooltip({ ...beside, className: "tip measured" });
  /** @type {any[]} */
  let points = [];
  let isOn = false;

  /** @param {any} [pointer] Where the next point would be. */
  const draw = (pointer) => {
    const line = pointer ? [...points, pointer] : points;
    drawing.clearLayers();
    drawing.addLayer(new Polyline(line, { ...look, className: "measure" }));
    for (const point of points)
      drawing.addLayer(new CircleMarker(point, { ...look, radius: 4, className: "measure-point" }));
    sum.remove();
    if (!points.length) return;
    const metres = line.slice(1).reduce((total, point, i) => total + distanceM(line[i], point, local), 0);
    sum.setLatLng(line[line.length - 1]).setContent(el("strong", formatMetres(metres, metres < 100 ? 2 : 1)));
    drawing.addLayer(sum);
  };
  /** @param {any} event */
  const add = ({ latlng }) => {
    points.push(latlng);
    draw();
    announce(sum.getContent()?.textContent ?? "");
  };
  const follow = (/** @type {any} */ { latlng }) => points.length && draw(latlng);

  toggle = () => {
    isOn = !isOn;
    button.setAttribute("aria-pressed", String(isOn));
    map.getContainer().classList.toggle("measuring", isOn);
    map.doubleClickZoom[isOn ? "disable" : "enable"]();
    points = [];
    draw();
    if (isOn) drawing.addTo(map);
    else drawing.remove();
    map[isOn ? "on" : "off"]({ click: add, mousemove: follow });
    document[isOn ? "addEventListener" : "removeEventListener"]("keydown", onKey, true);
    if (isOn) map.closePopup();
  };
  const onKey = (/** @type {any} */ event) => {
    if (isTyping(event)) return;
    if (event.key === "Escape") {
      event.stopPropagation(); // what else it closes stays open
      toggle();
    }
    if (event.key === "Backspace") {
      points.pop();
      draw();
    }
  };
  map.on("unload", () => isOn && toggle());
  return { isOn: () => isOn };
}

export const MEASURE_KEYS = [{ key: "m", text: "Measure distances; Escape ends", run: () => shown.result && toggle() }];
