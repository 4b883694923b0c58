/** Tips under the pointer, and the details of what is chosen: by a click, from a list, by a link. */

import { copyButton, factList, outLink } from "../controls.js";
import { el } from "../dom.js";
import { Popup } from "../leaflet.js";
import { showMessage } from "../messages.js";
import { getState, setState } from "../state.js";
import { legendWidth } from "./corners.js";
import { factsOf, isOsmNode, signOf, summaryOf, titleOf, whyOf } from "./facts.js";
import { coordinates, linksAt, noteText } from "./links.js";
import { ring } from "./pointer.js";
import { shown } from "./shown.js";
import { signIcon } from "./symbols.js";

/** @import { Result } from "../data/results.js" */
/** @import { Hit } from "./scene.js" */

const FEW = 2; // facts that are seen at once

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
  const { result } = shown;
  const { kind, item } = chosen ?? {};
  return result && kind === "intersection" ? frameOf(item.properties, result) : (item?.properties.frame ?? null);
}

/** Show all that is known of a thing. @param {Hit} hit */
export function openDetails(hit) {
  const { map, result } = shown;
  if (!map || !result) return;
  const { item, kind } = hit;
  chosen = hit;
  const around = ring("chosen").setLatLng([item.lat, item.lng]).addTo(map);
  const popup = popupOf(map, item, contentOf(hit, result));
  popup.on("remove", () => {
    around.remove();
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

/** What matters of it, and the rest folded. @param {Hit} hit @param {Result} result */
function contentOf(hit, result) {
  const { kind, item } = hit;
  const sign = signOf(hit);
  const why = whyOf(hit, result);
  const facts = factsOf(hit, result).filter((each) => each !== false);
  const frame = kind === "road" ? null : chosenFrame();
  const inReport = () => setState({ panel: "result" });
  const [near, far] = waysOut(hit, result);
  return el("div.details", [
    el("h3", sign && signIcon(sign), titleOf(hit)),
    item.properties.names && el("p.streets", item.properties.names),
    why && el("p.why", why),
    factList("", facts.slice(0, FEW)),
    el("div.row", [
      frame !== null && el("button", { onClick: () => setState({ frame, drawer: true }) }, "Look inside"),
      near,
      (ofService(item.properties) || getState().service) && serviceSwitch(result),
    ]),
    el("details", { onToggle: () => showWhole(shown.map) }, [
      el("summary", "More"),
      factList("", facts.slice(FEW)),
      el("div.ways-out.row", [
        (kind === "intersection" || kind === "node") && el("button", { onClick: inReport }, "In the list"),
        far,
        copyButton("Copy coordinates", () => coordinates(item, result.local)),
        !result.local &&
          !result.isMadeUp &&
          kind !== "road" &&
          copyButton("Copy OSM note", () => noteText(hit, result.report?.osm.date)),
      ]),
    ]),
  ]);
}

/** @param {any} properties @returns {boolean} Whether it is wrong for a junction with a service road alone. */
export const ofService = ({ reason }) => /highway=service\b.*leaves out/.test(reason ?? "");

/**
 * A button that counts service roads as roads of the map, or no longer.
 * @param {Result} result
 * @returns {HTMLElement|null} null where the result does not say what comes of it.
 */
export function serviceSwitch({ report }) {
  if (!report?.with_service) return null;
  const { service } = getState();
  const props = { type: "button", onClick: () => setState({ service: !service }) };
  return el("button", props, service ? "Leave service roads out" : "Count service roads too");
}

/**
 * @param {any} properties Of an intersection.
 * @param {Result} result
 * @returns {number} The keyframe in the middle of those that saw it.
 */
function frameOf({ id, first_frame, last_frame }, result) {
  const own = result.detections.filter(({ properties }) => properties.intersection === id);
  return own[own.length >> 1]?.properties.frame ?? Math.round((first_frame + last_frame) / 2);
}

/** Links to OpenStreetMap and its editor, and those to elsewhere. @param {Hit} hit @param {Result} result @returns {any[][]} */
function waysOut({ item, kind }, result) {
  if (result.local || result.isMadeUp) return [[], []];
  const id = kind === "detection" ? null : (item.properties.osm_id ?? null);
  const links = linksAt(item.lat, item.lng, isOsmNode(id, result) ? id : null).map(({ name, href, title }) =>
    outLink(href, name, { title, onClick: name === "JOSM" && tellOfJosm }),
  );
  return [links.slice(0, 2), links.slice(2)];
}

function tellOfJosm() {
  showMessage("Sent to JOSM, in a new tab. Did it not answer? Start JOSM and switch on its remote control.");
}
