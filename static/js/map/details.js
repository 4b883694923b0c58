/** Tips under the pointer, and the details of what is chosen: by a click, from a list, by a link. */

import { factList } from "../controls.js";
import { el } from "../dom.js";
import { Popup } from "../leaflet.js";
import { showMessage } from "../messages.js";
import { getState, setState } from "../state.js";
import { legendWidth } from "./corners.js";
import { factsOf, isOsmNode, signOf, summaryOf, titleOf, waysOut, whyOf } from "./facts.js";
import { ring } from "./pointer.js";
import { shown } from "./shown.js";
import { signIcon } from "./symbols.js";

/** @import { Result } from "../data/results.js" */
/** @import { Hit } from "./scene.js" */

/** @param {Hit} hit @returns {HTMLElement} What it is, in a few words. */
export function tipOf(hit) {
  const lines = [hit.item.properties.names, summaryOf(hit)].filter(Boolean).map((line) => [el("br"), line]);
  return el("div", el("strong", titleOf(hit)), lines);
}

/** What is chosen stays in the picture when the map gets another size, as beside a drawer. @param {any} map */
export function keepDetails(map) {
  const observer = new ResizeObserver(() => map.invalidateSize({ pan: false }));
  observer.observe(map.getContainer());
  map.on("unload", () => observer.disconnect());
  map.on("resize", () => showWhole(map));
}

/** Move the map so that the details are wholly on it. @param {any} map */
function showWhole(map) {
  const box = map.getContainer().querySelector(".leaflet-popup");
  if (!chosen || !box) return;
  const { item } = chosen;
  const { x, y } = map.getSize();
  const aside = Math.min(box.offsetWidth / 2 + 20, x / 2 - 10);
  const paddingTopLeft = [aside, Math.min(box.offsetHeight + 24, y - 30)];
  const right = Math.min(aside + legendWidth(map), x - aside - 1);
  map.panInside([item.lat, item.lng], { paddingTopLeft, paddingBottomRight: [right, 30], animate: false });
}

/** What is open now, and what a move of the map leads to: the newest counts. @type {Hit|null} */
let chosen = null;

/** @returns {boolean} Whether details are open: the map stays where they are read. */
export const hasDetails = () => chosen !== null;

/** @returns {number|null} The keyframe of what is chosen: that in the middle of those that saw an intersection. */
export function chosenFrame() {
  const { kind, item } = chosen ?? {};
  if (kind !== "intersection") return item?.properties.frame ?? null;
  const { id, first_frame, last_frame } = item.properties;
  const own = shown.result?.detections.filter(({ properties }) => properties.intersection === id) ?? [];
  return own[own.length >> 1]?.properties.frame ?? Math.round((first_frame + last_frame) / 2);
}

/** Show what is known of a thing. @param {Hit} hit */
export function openDetails(hit) {
  const { map, result } = shown;
  if (!map || !result) return;
  const { item, kind } = hit;
  chosen = hit;
  const around = ring("chosen").setLatLng([item.lat, item.lng]).addTo(map);
  const popup = popupOf(map, item, contentOf(hit, result));
  popup.on("remove", () => {
    around.remove();
    if (popup.getElement()?.contains(document.activeElement)) map.getContainer().focus({ preventScroll: true });
    if (chosen !== hit) return; // another one takes its place
    chosen = null;
    setState({ intersection: null, node: null });
  });
  popup.openOn(map);
  setState({ ...selectionOf(hit), ...(kind === "detection" && { frame: item.properties.frame }) });
}

/** @param {any} map @param {{lat: number, lng: number}} place @param {HTMLElement} content @returns {any} A box, to be opened. */
export function popupOf(map, { lat, lng }, content) {
  const room = map.getSize().x - 80; // beside its margins and those of the map
  const options = { maxWidth: Math.min(320, room), minWidth: Math.min(290, room), autoPanPadding: [24, 24] };
  return new Popup(options).setLatLng([lat, lng]).setContent(content);
}

/** Go to a thing and open its details. @param {Hit} hit */
export function goTo(hit) {
  const { map, result } = shown;
  if (!map || !result) return;
  chosen = hit;
  setState(selectionOf(hit));
  const zoom = Math.max(map.getZoom(), result.local ? 2.5 : 18.5);
  // While the map moves the box would not find its room; a move that is overtaken by another opens nothing.
  map.once("moveend", () => chosen === hit && openDetails(hit));
  map.setView([hit.item.lat, hit.item.lng], zoom, { animate: !matchMedia("(prefers-reduced-motion: reduce)").matches });
}

/** Go to a node of OpenStreetMap. @param {string} osmId */
export function goToNode(osmId) {
  const item = shown.result?.nodes.find(({ properties }) => String(properties.osm_id) === String(osmId));
  if (item) goTo({ kind: "node", item });
}

/** @param {Hit} hit @returns {{intersection: string|null, node: string|null}} */
function selectionOf({ kind, item }) {
  return {
    intersection: kind === "intersection" ? String(item.properties.id) : null,
    node: kind === "node" ? String(item.properties.osm_id) : null,
  };
}

/** @param {string|null} name Id or uid. @param {import("../data/results.js").Place} intersection */
export const isNamed = (name, { properties: p }) => name !== null && (name === String(p.id) || name === p.uid);

/** Show what the address names, where that is not what is shown. @param {(hit: Hit) => void} open */
export function openSelection(open) {
  const { result, map } = shown;
  const { intersection, node, job } = getState();
  if (!result || result.job.id !== job) return;
  const own = chosen && selectionOf(chosen);
  if (own?.intersection === intersection && own?.node === node) return;
  const place = result.intersections.find((each) => isNamed(intersection, each));
  const osm = result.nodes.find(({ properties }) => String(properties.osm_id) === node);
  if (place) open({ kind: "intersection", item: place });
  else if (osm) open({ kind: "node", item: osm });
  else if (intersection !== null) showMessage(`This result has no intersection ${intersection}.`);
  else if (node !== null) showMessage(`This result has no OSM node ${node}.`);
  else if (own?.intersection || own?.node) map.closePopup();
}

/** Close the details; what is chosen stays so, for the result that comes. */
export function closeDetails() {
  chosen = null;
  shown.map?.closePopup();
}

/** @param {Hit} hit @param {Result} result */
function contentOf(hit, result) {
  const { kind, item } = hit;
  const sign = signOf(hit);
  const why = whyOf(hit, result);
  const frame = kind === "road" ? null : chosenFrame();
  const id = kind === "detection" ? null : item.properties.osm_id;
  return el("div.details", [
    el("h3", sign && signIcon(sign), titleOf(hit)),
    item.properties.names && el("p.streets", item.properties.names),
    why && el("p.why", why),
    factList("", factsOf(hit, result)),
    el("div.row", [
      frame !== null && el("button", { onClick: () => setState({ frame, drawer: true }) }, "Look inside"),
      !result.local && !result.isMadeUp && waysOut(item, isOsmNode(id, result) ? id : null),
    ]),
  ]);
}
