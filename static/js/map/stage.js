/**
 * The map: shows the result of the job at hand, or the trajectory of its drive while it runs.
 * @module map/stage
 */

import { getJson } from "../api.js";
import { lists, onListsChange, rememberJob } from "../data/lists.js";
import { loadResult, loadTrajectory } from "../data/results.js";
import { el, fill, icon } from "../dom.js";
import { CRS, control, LeafletMap, latLngBounds } from "../leaflet.js";
import { problemNote } from "../messages.js";
import { getState, setState, subscribe } from "../state.js";
import { watchPointer } from "./details.js";
import { KeyframeLayer } from "./keyframe.js";
import { layersOn } from "./layers.js";
import { addLegend } from "./legend.js";
import { roadSurface } from "./road_surface.js";
import { Scene } from "./scene.js";
import { setResult, shown } from "./shown.js";
import { Surface } from "./surface.js";
import { makeTiles, onTilesChange } from "./tiles.js";
import { mountTimeline } from "./timeline.js";

const OSM_CREDIT = "© OpenStreetMap contributors, ODbL";
const LOCAL_CREDIT = "Metres of the drive’s own frame: it has no georeference";

/** @type {Scene|null} */
let scene = null;
/** Whether the map shows a place of the result, worth a permalink. */
let isPlaced = false;

/** Put map, legend and timeline on the page. */
export async function mountStage() {
  const holder = /** @type {HTMLElement} */ (document.getElementById("map"));
  const cover = el("div", { class: "cover" });
  holder.before(cover);
  const timeline = mountTimeline(/** @type {HTMLElement} */ (document.getElementById("strip")));
  /** @type {any} */
  let parts = null;
  let token = 0;

  /** @param {boolean} local */
  const build = (local) => {
    if (parts?.local === local) return;
    shown.map?.remove();
    parts = makeMap(holder, local, () => scene);
    shown.map = parts.map;
    shown.map.on("moveend", () => isPlaced && setState({ view: viewText() }));
  };

  const showDrive = async () => {
    const mine = ++token;
    const { job: id, drive } = getState();
    if (!id) {
      clear();
      fill(cover, welcome(drive));
      return;
    }
    try {
      const job =
        lists.jobs.find((each) => each.id === id && each.state === "successful") ?? (await getJson(`jobs/${id}`));
      if (mine !== token) return;
      if (job.kind === "intersections") rememberJob(job);
      if (getState().drive !== job.drive_id) setState({ drive: job.drive_id });
      if (job.state !== "successful") {
        clear();
        fill(cover, el("p", {}, waiting(job)));
        if (!isOver(job)) await showTrajectory(job, mine);
        return;
      }
      if (shown.result?.job.id === id) return;
      fill(cover, el("p", {}, "Loading the result…"));
      const next = await loadResult(job);
      if (mine === token) show(next);
    } catch (error) {
      if (mine !== token) return;
      clear();
      fill(cover, problemNote(error));
    }
  };

  /** @param {any} job @param {number} mine */
  const showTrajectory = async (job, mine) => {
    const track = await loadTrajectory(job);
    if (mine !== token || !track) return;
    fill(cover);
    build(track.local);
    scene = new Scene(track, shown.map);
    scene.on = new Set(["track"]);
    scene.progress = job.progress.fraction;
    const places = track.trajectory.map(([lng, lat]) => [lat, lng]);
    fit(places, false, track.local);
    parts.redraw();
  };

  /** @param {import("../data/results.js").Result} next */
  const show = (next) => {
    fill(cover);
    build(next.local);
    scene = new Scene(next, shown.map);
    updateLayers();
    parts.legend.show(next);
    parts.setAttribution(next);
    isPlaced = false;
    timeline.show(next);
    setResult(next);
    shown.map.invalidateSize({ animate: false }); // timeline and drawer have taken their room: now the map has its size
    const { view, frame } = getState();
    if (!(view && applyView(view))) fitDrive(false);
    isPlaced = true;
    if (frame !== null && !next.frame.rows.has(frame)) setState({ frame: null });
    updateKeyframe();
  };

  const clear = () => {
    isPlaced = false;
    scene = null;
    parts?.legend.show(null);
    parts?.redraw();
    parts?.keyframe.show(null, null, false);
    shown.map?.closePopup();
    parts?.setTiles(false);
    parts?.surface.show(null);
    timeline.show(null);
    setResult(null);
  };

  const updateLayers = () => {
    if (!scene) return;
    scene.on = layersOn(getState().layers);
    parts.setTiles(scene.on.has("tiles") && !scene.result.local);
    parts.surface.show(scene.on.has("surface") ? scene.result.surface : null);
    parts.redraw();
  };

  const updateKeyframe = () => {
    if (!shown.result) return;
    const row = shown.result.frame.rows.get(getState().frame);
    const keyframe = row === undefined ? null : shown.result.keyframes[row];
    parts.keyframe.show(shown.result, keyframe, layersOn(getState().layers).has("zone"));
    if (keyframe && timeline.isFollowing()) keepInView([keyframe.lat, keyframe.lng]);
  };

  subscribe(["job", "drive"], () => void showDrive());
  subscribe(["layers"], () => (updateLayers(), updateKeyframe()));
  subscribe(["frame", "drawer"], updateKeyframe);
  onTilesChange(() => (parts?.setTiles(false), updateLayers()));
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => parts?.redraw());
  document.addEventListener("job-finished", () => void showDrive());
  onListsChange(() => {
    const job = lists.jobs.find((each) => each.id === getState().job);
    if (!job || !scene || shown.result || scene.progress === job.progress.fraction) return;
    scene.progress = job.progress.fraction;
    parts.redraw();
  });
  await showDrive();
}

/** @param {HTMLElement} holder @param {boolean} local @param {() => Scene|null} current */
function makeMap(holder, local, current) {
  const made = new LeafletMap(holder, {
    crs: local ? CRS.Simple : CRS.EPSG3857,
    zoomControl: false,
    attributionControl: false,
    zoomSnap: 0.25,
    zoomDelta: 0.75,
    wheelPxPerZoomLevel: 90,
    minZoom: local ? -6 : 3,
    maxZoom: local ? 7 : 24,
    maxBoundsViscosity: 0,
  });
  made.setView([0, 0], local ? 0 : 3);
  for (const [name, z] of /** @type {const} */ ([
    ["ground", 240],
    ["pictures", 300],
    ["surface", 350],
    ["keyframe", 450],
    ["marks", 600],
  ])) {
    made.createPane(name).style.zIndex = String(z);
    if (name !== "pictures") made.getPane(name).style.pointerEvents = "none";
  }
  const ground = new Surface(
    (/** @type {any} */ context, /** @type {any} */ view) => current()?.paintGround(context, view),
    { pane: "ground" },
  ).addTo(made);
  const surface = new Surface(
    (/** @type {any} */ context, /** @type {any} */ view) => current()?.paint(context, view),
    { pane: "surface" },
  ).addTo(made);
  control.zoom({ position: "topleft" }).addTo(made);
  addFit(made);
  control.scale({ position: "bottomleft", imperial: false, maxWidth: 140 }).addTo(made);
  const attribution = control.attribution({ position: "bottomright", prefix: false }).addTo(made);
  const legend = addLegend(made);
  watchPointer(made, current);
  /** @type {any} */
  let tiles = null;
  /** @type {string|null} */
  let credit = null;
  return {
    map: made,
    local,
    redraw() {
      ground.redraw();
      surface.redraw();
    },
    legend,
    keyframe: new KeyframeLayer(made),
    surface: roadSurface(made),
    /** @param {boolean} on */
    setTiles(on) {
      if (on && !tiles) {
        tiles = makeTiles();
        tiles?.once("tileload", () => holder.classList.add("with-tiles")); // else the roads stay the base map
        tiles?.addTo(made);
      } else if (!on && tiles) {
        tiles.off();
        tiles.remove();
        tiles = null;
        holder.classList.remove("with-tiles");
      }
    },
    /** @param {import("../data/results.js").Result} shown */
    setAttribution(shown) {
      if (credit) attribution.removeAttribution(credit);
      const osm = shown.roads.length || shown.nodes.length ? OSM_CREDIT : null;
      credit = shown.local ? LOCAL_CREDIT : osm;
      if (credit) attribution.addAttribution(credit);
    },
  };
}

/** @param {any} made */
function addFit(made) {
  const label = "Show the whole drive";
  const onClick = (/** @type {Event} */ e) => (e.preventDefault(), fitDrive(true));
  const button = el("a", { href: "#", role: "button", title: label, "aria-label": label, onClick }, icon("fit"));
  const bar = el("div", { class: "leaflet-bar leaflet-control" }, button);
  const fit = control.zoom({ position: "topleft" });
  fit.onAdd = () => bar;
  fit.onRemove = () => {};
  fit.addTo(made);
}

/** @param {boolean} animate */
function fitDrive(animate) {
  const { result } = shown;
  if (!result) return;
  const places = [...result.keyframes, ...result.intersections].map(({ lat, lng }) => [lat, lng]);
  fit(places, animate, result.local);
}

/** @param {number[][]} places lat, lng @param {boolean} animate @param {boolean} local */
function fit(places, animate, local) {
  if (!places.length) return;
  const [paddingTopLeft, paddingBottomRight] = margins();
  shown.map.fitBounds(latLngBounds(places), { paddingTopLeft, paddingBottomRight, animate, maxZoom: local ? 4 : 19.5 });
}

/** @returns {number[][]} What the controls cover: left and top, right and bottom, pixels. */
function margins() {
  const hasLegend = shown.map.getSize().x >= 640 && localStorage.getItem("interloc.legend") !== "no";
  return [
    [56, 40],
    [hasLegend ? 232 : 40, 40],
  ];
}

/** @param {[number, number]} place */
function keepInView(place) {
  const [[left, top], [right, bottom]] = margins();
  const { x, y } = shown.map.latLngToContainerPoint(place);
  const size = shown.map.getSize();
  if (x > left && y > top && x < size.x - right && y < size.y - bottom) return;
  const target = [left + (size.x - left - right) / 2, top + (size.y - top - bottom) / 2];
  shown.map.panBy([x - target[0], y - target[1]], { animate: false });
}

/** @returns {string} */
function viewText() {
  const { lat, lng } = shown.map.getCenter();
  const digits = shown.result?.local ? 1 : 6;
  return `${Number(shown.map.getZoom().toFixed(2))}/${lat.toFixed(digits)}/${lng.toFixed(digits)}`;
}

/** @param {string} text @returns {boolean} */
function applyView(text) {
  const [zoom, lat, lng] = text.split("/").map(Number);
  if (![zoom, lat, lng].every(Number.isFinite)) return false;
  shown.map.setView([lat, lng], zoom, { animate: false });
  return true;
}

/** @param {any} job @returns {boolean} */
function isOver(job) {
  return job.state === "failed" || job.state === "dismissed";
}

/** @param {any} job @returns {string} */
function waiting(job) {
  if (job.state === "failed") return "This job failed; its panel says why.";
  if (job.state === "dismissed") return "This job was cancelled.";
  return "The map appears here when the job is done.";
}

/** @param {string|null} drive */
function welcome(drive) {
  return drive
    ? el("p", {}, "This drive has no result yet. Run it from the list of drives.")
    : el(
        "div",
        {},
        el("h2", {}, "Intersections from LiDAR drives"),
        el(
          "p",
          {},
          "Upload a drive, or open one of the list: its intersections appear here, beside the roads of OpenStreetMap.",
        ),
      );
}
