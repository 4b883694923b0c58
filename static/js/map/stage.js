/** The map: shows the result of the job at hand, or the trajectory of its drive while it runs. */

import { follow, getConfig, keepLooking, onTokenChange } from "../api.js";
import { chosenCity, cities, loadMaps, onCityChange, versionOf, wantsCity, watchMaps } from "../data/city.js";
import { demo, onDemoChange, tryDemo } from "../data/demo.js";
import { FINAL, lists, onListsChange, rememberJob, tellThatMapIsSeen } from "../data/lists.js";
import { loadResult, loadTrajectory } from "../data/results.js";
import { el, fill, icon, plural, takesDrops } from "../dom.js";
import { CRS, control, LeafletMap, latLngBounds } from "../leaflet.js";
import { leaveButton, problemNote, retryNote } from "../messages.js";
import { addShortcut } from "../shortcuts.js";
import { getState, setState, subscribe } from "../state.js";
import { CITY_KEYS, CityScene } from "./city.js";
import { PLACE_SIGNS, signOfChange } from "./city_places.js";
import { addButton, addCoordinates, legendWidth } from "./corners.js";
import { closeDetails, goTo, hasDetails, keepDetails, openDetails, openSelection } from "./details.js";
import { onFilterChange } from "./filter.js";
import { KeyframeLayer } from "./keyframe.js";
import { layersOn, NODE_OUTCOMES, VERDICTS } from "./layers.js";
import { addLegend, switchLayer } from "./legend.js";
import { LiveDrive, LiveScene } from "./live.js";
import { watchPointer } from "./pointer.js";
import { QUEUE_KEYS } from "./queue.js";
import { roadSurface } from "./road_surface.js";
import { Scene } from "./scene.js";
import { onPreview, setResult, shown } from "./shown.js";
import { Surface } from "./surface.js";
import { signIcon } from "./symbols.js";
import { makeTiles, OSM_CREDIT } from "./tiles.js";
import { mountTimeline } from "./timeline.js";

/** @import { Result } from "../data/results.js" */

/** What the signs of the map mean, where there is no legend. */
const KEYS = { ...VERDICTS, missed: NODE_OUTCOMES.missed };
const AGAIN_MS = 3000; // until a map of many drives that could not be read is asked for again
const LIVE_MS = 200; // between two pictures of a drive that is under way
const LOCAL_CREDIT = "Metres of the drive’s own frame: it has no georeference";

/** @type {Scene|CityScene|null} */
let scene = null;
/** What the map was last fitted to. @type {{places: number[][], local: boolean}|null} */
let whole = null;
/** What was last shown before it was sent: its roads stay while its job runs. @type {Result|null} */
let previewed = null;
/** Whether the map shows a place of the result, worth a permalink. */
let isPlaced = false;

/** Put map, legend and timeline on the page. */
export async function mountStage() {
  const holder = /** @type {HTMLElement} */ (document.getElementById("map"));
  const cover = el("div.cover");
  const note = el("div.stage-note.row");
  holder.before(cover, note);
  const timeline = mountTimeline(/** @type {HTMLElement} */ (document.getElementById("strip")));
  /** @type {any} */
  let parts = null;
  let token = 0;
  /** Id of the job whose end is awaited: the list knows of it, from whomever it heard. @type {string|null} */
  let awaited = null;

  /** @param {boolean} local */
  const build = (local) => {
    if (parts?.local === local) return;
    shown.map?.remove();
    parts = makeMap(holder, local, () => scene);
    shown.map = parts.map;
    const isOfState = () => (shown.result?.job.id ?? null) === getState().job; // not while the next one is loaded
    shown.map.on("moveend", () => isPlaced && isOfState() && setState({ view: viewText() }));
  };

  const showDrive = async () => {
    const mine = ++token;
    const { job: id, drive, panel, live } = getState();
    watching?.abort();
    fill(note);
    if (panel === "upload" && shown.preview) return showPreview(shown.preview);
    try {
      if (wantsCity() && (await showCity(mine))) return;
      if (mine !== token) return;
      if (live) return await showLive(live);
      if (!id) {
        clear();
        return fill(cover, welcome(drive));
      }
      if (shown.result?.job.id === id) return;
      fill(cover, el("p", { role: "status" }, "Loading the result…"));
      const { job, result } = await loadResult(id);
      if (mine !== token) return;
      rememberJob(job);
      awaited = FINAL.has(job.state) ? null : id;
      if (getState().drive !== job.drive_id) setState({ drive: job.drive_id });
      if (result) return show(result);
      clear();
      fill(cover, el("p", waiting(job)));
      if (awaited) await showTrajectory(job, mine);
    } catch (error) {
      if (mine !== token) return;
      clear();
      fill(cover, retryNote(error, showDrive));
    }
  };

  /** What is heard of a live session. @type {AbortController|null} */
  let watching = null;
  /** @param {string} id */
  const showLive = async (id) => {
    clear();
    fill(cover, el("p", "Waiting for the vehicle…"));
    const drive = new LiveDrive();
    watching = new AbortController();
    const { signal } = watching;
    let isDue = false;
    const draw = () => {
      isDue = false;
      if (signal.aborted) return;
      if (!drive.vehicle) return drive.end && fill(cover, el("p", drive.end));
      const isNew = !(scene instanceof LiveScene);
      fill(cover);
      fill(note, el("strong", drive.session.name), ` ${drive.words}`);
      build(!drive.session.georeferenced);
      scene = new LiveScene(drive, shown.map);
      const { lat, lng } = drive.vehicle;
      if (isNew) fit([...drive.track, [lng, lat]], false, !drive.session.georeferenced);
      else keepInView([lat, lng]);
      parts.redraw();
    };
    const onEvent = (/** @type {any} */ said) => {
      const isOver = drive.take(said);
      if (!isDue) setTimeout(draw, LIVE_MS);
      isDue = true;
      return isOver;
    };
    await follow(`live/${id}/events`, { onEvent, signal });
  };

  /** @param {any} job @param {number} mine */
  const showTrajectory = async (job, mine) => {
    const track = await loadTrajectory(job);
    if (mine !== token || !track) return;
    fill(cover);
    build(track.local);
    const isOfPreview = previewed?.trajectory.some(([lng, lat]) => isNear([lng, lat], track.trajectory[0]));
    scene = new Scene(isOfPreview ? { ...track, roads: previewed?.roads ?? [] } : track, shown.map);
    scene.on = new Set(["roads", "track"]);
    scene.progress = job.progress.fraction;
    fit(track.trajectory, false, track.local);
    parts.redraw();
  };

  /** @param {import("./shown.js").Preview} preview */
  const showPreview = ({ result, title, text, progress }) => {
    const isNew = !(scene instanceof Scene) || scene.result.trajectory !== result.trajectory;
    if (isNew) clear();
    previewed = result.local ? null : result;
    fill(cover);
    fill(note, el("strong", title), ` ${text}`);
    build(result.local);
    if (!(scene instanceof Scene) || scene.result !== result) scene = new Scene(result, shown.map);
    scene.at = () => null; // its places have no details yet
    scene.on = new Set(["roads", "places", "track", "keyframes"]);
    scene.progress = progress;
    parts.setAttribution(result);
    if (isNew) fit(result.trajectory, false, result.local);
    parts.redraw();
  };

  let isAsking = false; // for the maps of many drives
  /** What of them was shown last. @type {string|null} */
  let cityShown = null;
  /** @param {number} mine @returns {Promise<boolean>} Whether there is a map of many drives to show. */
  const showCity = async (mine) => {
    isAsking = true;
    await loadMaps().finally(() => (isAsking = false));
    if (mine !== token) return true;
    const city = chosenCity();
    cityShown = city && versionOf(city);
    if (city?.bbox) {
      const box = city.bbox;
      if (scene instanceof CityScene && scene.city.id === city.id) {
        scene.renew(city);
        tellOfCity(scene);
        return true;
      }
      clear();
      fill(cover);
      build(false);
      const fitIt = () => {
        const tracks = own.items.flatMap(({ track }) => track);
        fit([box.slice(0, 2), box.slice(2), ...tracks], false, false);
      };
      const own = new CityScene(city, shown.map, (isFirst) => {
        if (scene !== own) return;
        tellOfCity(own);
        if (isFirst && !cities.entry) fitIt(); // the note has its size now
        parts.redraw();
        tellThatMapIsSeen();
      });
      scene = own;
      tellOfCity(own);
      updateLayers();
      parts.setAttribution({ roads: [city], nodes: [], local: false, isMadeUp: city.is_made_up });
      fitIt();
      own.goToEntry(false);
      own.look();
      return true;
    }
    if (getState().panel !== "map" || !lists.drives.length) return false;
    clear();
    fill(cover, el("p", city ? emptyCity(city) : "There is no such map."));
    return true;
  };

  /** @param {CityScene} city */
  const tellOfCity = ({ city, spots, cut }) => {
    const toQueue = () => setState({ panel: "map" });
    const signs = new Set(spots.flatMap(({ sign, changes }) => [sign, ...changes.map(signOfChange)]));
    fill(
      note,
      el("strong", plural(city.intersections, "intersection")),
      ` of ${plural(city.drives, "drive")}`,
      city.is_waiting && " · more is being merged",
      cut && ` · ${cut} here: zoom in for more`,
      city.findings && getState().panel !== "map"
        ? [" · ", el("button.link", { onClick: toQueue }, plural(city.findings, "finding"))]
        : null,
      Object.entries(PLACE_SIGNS)
        .filter(([name]) => signs.has(name))
        .map(([name, [text, hint]]) => el("span.key-row", { title: hint }, signIcon(name), text)),
      tileSwitch(),
    );
  };

  /** @param {Result} result */
  const show = (result) => {
    fill(cover);
    fill(note); // the map of many drives may have said something while this one was on its way
    closeDetails();
    build(result.local);
    scene = new Scene(result, shown.map);
    updateLayers();
    parts.legend.show(result);
    parts.setAttribution(result);
    isPlaced = false;
    timeline.show(result);
    setResult(result);
    shown.map.invalidateSize({ animate: false }); // timeline and drawer have taken their room: now the map has its size
    const { view, frame } = getState();
    if (!(view && applyView(view))) fitDrive(false);
    isPlaced = true;
    openSelection(view ? openDetails : goTo);
    if (frame !== null && !result.frame.rows.has(frame)) setState({ frame: null });
    updateKeyframe();
  };

  const clear = () => {
    isPlaced = false;
    scene = null;
    parts?.legend.show(null);
    parts?.redraw();
    parts?.keyframe.show(null, null, false);
    closeDetails();
    parts?.setTiles(false);
    parts?.surface.show(null);
    timeline.show(null);
    setResult(null);
  };

  const updateLayers = () => {
    if (!scene) return;
    scene.on = layersOn(getState().layers);
    parts.setTiles(scene.on.has("tiles") && !scene.result.local);
    parts.surface.show(scene instanceof Scene && scene.on.has("surface") ? scene.result.surface : null);
    parts.redraw();
  };

  const updateKeyframe = () => {
    if (!shown.result) return;
    const row = shown.result.frame.rows.get(getState().frame);
    const keyframe = row === undefined ? null : shown.result.keyframes[row];
    parts.keyframe.show(shown.result, keyframe, layersOn(getState().layers).has("zone"));
    if (keyframe && timeline.isFollowing() && !hasDetails()) keepInView([keyframe.lat, keyframe.lng]);
  };

  subscribe(["job", "drive", "live", "map"], ({ job, live, map }, before) => {
    const known = shown.result?.job;
    if (known && known.id === job) {
      if (job !== before.job) {
        token += 1; // what was on its way is not wanted any more
        fill(cover);
      }
      return setState({ drive: known.drive_id }); // an address may leave it out
    }
    const isOther = job !== before.job || live !== before.live || map !== before.map;
    if (isOther || !job) void showDrive(); // of a job the drive is learnt when it comes
  });
  subscribe(["panel"], ({ panel }, before) => {
    const isMap = panel === "map";
    if (shown.preview || isMap !== (before.panel === "map")) void showDrive();
  });
  subscribe(["view"], ({ view }) => isPlaced && view && view !== viewText() && applyView(view));
  onTokenChange(() => void showDrive());
  subscribe(["finding"], () => scene instanceof CityScene && parts.redraw());
  /** Id of the finding that was gone to. @type {string|null} */
  let looked = null;
  onCityChange(() => {
    const city = chosenCity();
    if (!wantsCity() || isAsking) return;
    if ((city && versionOf(city)) !== cityShown) void showDrive();
    if (!(scene instanceof CityScene)) return;
    scene.judged();
    parts.redraw();
    if (cities.entry && cities.entry.id !== looked) scene.goToEntry();
    looked = cities.entry?.id ?? null;
  });
  watchMaps();
  keepLooking(AGAIN_MS, async () => void (scene instanceof CityScene && scene.look())); // what could not be read
  onPreview(() => {
    const { panel, job, drive } = getState();
    if (panel === "upload" || (!job && !drive && !getState().live)) void showDrive();
  });
  subscribe(["layers"], () => (updateLayers(), updateKeyframe()));
  subscribe(["frame", "drawer"], updateKeyframe);
  subscribe(["panel", "drawer"], () => innerWidth <= 900 && shown.map?.closePopup()); // the room is for what comes
  subscribe(["intersection", "node"], () => openSelection(goTo)); // another address, or back in the history
  onFilterChange(() => parts?.redraw());
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => parts?.redraw());
  onListsChange(() => {
    const job = lists.jobs.find((each) => each.id === getState().job);
    if (job?.id === awaited && FINAL.has(job.state)) {
      awaited = null;
      void showDrive();
    }
    if (!job || !scene || shown.result || scene.progress === job.progress.fraction) return;
    scene.progress = job.progress.fraction;
    parts.redraw();
  });
  /** @type {string|null} */
  let drivesShown = null;
  onListsChange(() => {
    if (!lists.isWhole) return; // the rest comes in a moment
    const done = lists.jobs.filter(({ state }) => state === "successful");
    const now = [...lists.drives.map(({ id, state }) => `${id} ${state}`), ...done.map(({ id }) => id)].join();
    if (now === drivesShown) return;
    const isFirst = drivesShown === null;
    drivesShown = now;
    if (scene instanceof CityScene) return scene.loadRoads();
    const { job, drive, live } = getState();
    if (job || live) return;
    if (isFirst && !lists.drives.length) fill(cover, welcome(drive));
    else void showDrive();
  });
  let demoNow = "";
  onDemoChange(() => {
    const now = `${demo.isRunning} ${demo.error}`;
    if (now === demoNow) return; // but for its progress
    demoNow = now;
    if (!getState().job && !getState().drive && !getState().live) void showDrive();
  });
  for (const { key, text, run } of [...QUEUE_KEYS, ...CITY_KEYS]) addShortcut(key, text, run);
  await showDrive();
  if (!(scene instanceof CityScene)) tellThatMapIsSeen();
}

/** @param {HTMLElement} holder @param {boolean} local @param {() => any} current */
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
  for (const [name, z] of Object.entries({ ground: 240, pictures: 300, surface: 350, keyframe: 450, marks: 600 })) {
    made.createPane(name).style.zIndex = String(z);
    if (name !== "pictures") made.getPane(name).style.pointerEvents = "none";
  }
  const surfaceOf = (/** @type {string} */ pane, /** @type {"paint"|"paintGround"} */ paint) =>
    new Surface((/** @type {any[]} */ ...what) => current()?.[paint](...what), { pane }).addTo(made);
  const ground = surfaceOf("ground", "paintGround");
  const surface = surfaceOf("surface", "paint");
  control.zoom({ position: "topleft" }).addTo(made);
  addButton(made, "fit", "Show the whole drive", () => fitDrive(true));
  control.scale({ position: "bottomleft", imperial: false, maxWidth: 140 }).addTo(made);
  const attribution = control.attribution({ position: "bottomright", prefix: false }).addTo(made);
  const legend = addLegend(made);
  addCoordinates(made, local);
  watchPointer(made, current, () => surface.redraw());
  keepDetails(made);
  /** @type {any} */
  let tiles = null;
  /** @param {boolean} isOn Whether tiles have come, so that streets need no names of their own. */
  const cover = (isOn) => {
    holder.classList.toggle("with-tiles", isOn);
    const scene = current();
    if (scene) scene.hasTiles = isOn;
    surface.redraw();
  };
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
        tiles?.once("tileload", () => cover(true)); // else the roads and their names stay the base map
        tiles?.addTo(made);
      } else if (!on && tiles) {
        tiles.off("tileload tileerror");
        tiles.remove();
        tiles = null;
        cover(false);
      }
      const scene = current();
      if (scene) scene.hasTiles = holder.classList.contains("with-tiles");
    },
    /** @param {{roads: any[], nodes: any[], local: boolean, isMadeUp: boolean}} shown */
    setAttribution(shown) {
      if (credit) attribution.removeAttribution(credit);
      const osm = !shown.isMadeUp && (shown.roads.length || shown.nodes.length) ? OSM_CREDIT : null;
      credit = shown.local ? LOCAL_CREDIT : osm;
      if (credit) attribution.addAttribution(credit);
    },
  };
}

/** @param {boolean} animate */
function fitDrive(animate) {
  const { result } = shown;
  if (!result) return whole && fit(whole.places, animate, whole.local);
  const places = [...result.keyframes, ...result.intersections].map(({ lng, lat }) => [lng, lat]);
  fit(places, animate, result.local);
}

/**
 * @param {number[][]} places Longitude, latitude.
 * @param {boolean} animate
 * @param {boolean} local
 */
function fit(places, animate, local) {
  if (!places.length) return;
  whole = { places, local };
  const [paddingTopLeft, paddingBottomRight] = margins();
  const bounds = latLngBounds(places.map(([lng, lat]) => [lat, lng]));
  shown.map.fitBounds(bounds, { paddingTopLeft, paddingBottomRight, animate, maxZoom: local ? 4 : 19.5 });
}

/** @returns {number[][]} What controls, legend and note cover: left and top, right and bottom, pixels. */
function margins() {
  const note = shown.map.getContainer().parentElement.querySelector(".stage-note")?.offsetHeight ?? 0;
  const { y } = shown.map.getSize();
  return [
    [56, Math.min(note + 40, y / 3)],
    [legendWidth(shown.map) + 40, Math.min(40, y / 5)],
  ];
}

/** @param {number[]} a Longitude, latitude. @param {number[]} b @returns {boolean} Whether they are within some metres. */
const isNear = (a, b) => Math.abs(a[0] - b[0]) + Math.abs(a[1] - b[1]) < 1e-4;

/** @param {[number, number]} place */
function keepInView(place) {
  const [[left, top], [right, bottom]] = margins();
  const { x, y } = shown.map.latLngToContainerPoint(place);
  const size = shown.map.getSize();
  if (x > left && y > top && x < size.x - right && y < size.y - bottom) return;
  const target = [left + (size.x - left - right) / 2, top + (size.y - top - bottom) / 2];
  shown.map.panBy([x - target[0], y - target[1]], { animate: false });
}

function viewText() {
  const { lat, lng } = shown.map.getCenter();
  const digits = shown.result?.local ? 1 : 6;
  return `${Number(shown.map.getZoom().toFixed(2))}/${lat.toFixed(digits)}/${lng.toFixed(digits)}`;
}

/** @param {string} text */
function applyView(text) {
  const [zoom, lat, lng] = text.split("/").map(Number);
  if (![zoom, lat, lng].every(Number.isFinite)) return false;
  shown.map.setView([lat, lng], zoom, { animate: false });
  return true;
}

/** @param {any} job @returns {string} */
function waiting(job) {
  if (job.state === "failed") return "This job failed.";
  if (job.state === "dismissed") return "This job was cancelled.";
  return "The map appears here when the job is done.";
}

/** @param {import("../data/city.js").City} city @returns {string} Why there is nothing to see on it. */
function emptyCity({ holds_all, is_waiting }) {
  if (is_waiting) return "Its drives are being merged. The map appears here in a moment.";
  return holds_all
    ? "No drive is on this map yet. As soon as a drive with georeference has a result, its intersections appear here."
    : "No drive is on this map yet. Put drives into it, by its button Drives…, and their intersections appear here.";
}

/** @returns {HTMLElement|null} */
function tileSwitch() {
  if (!getConfig().tile_url) return null;
  const checked = layersOn(getState().layers).has("tiles");
  const onChange = () => switchLayer("tiles", !checked);
  return el("label.key-row", el("input", { type: "checkbox", checked, onChange }), "Map tiles");
}

/** @param {string|null} drive */
function welcome(drive) {
  const isGone = lists.isWhole && !lists.isCut && !lists.drives.some(({ id }) => id === drive);
  if (drive && isGone) return el("div.stack-s", el("p", "There is no such drive."), leaveButton());
  if (drive) return el("p", "No result of this drive is shown. Open one from the list of drives, or run it.");
  if (demo.isRunning) return el("p", { role: "status" }, "The demo is being prepared. It appears here.");
  if (!lists.isLoaded) return null;
  if (lists.drives.length)
    return el("p", "No drive has a result on the map of all drives yet. Open one from the list, or run it.");
  const open = () => setState({ panel: "upload" });
  return el("div.drop.drop-stage.stack", [
    icon("upload"),
    el("h2", takesDrops() ? "Drop the folder of a LiDAR drive here" : "Where are the road intersections of a drive?"),
    el("ol", [
      el("li", "The drive: its folder, or a bag. It is looked into before anything is sent."),
      el("li", "A map, if there is one: an OSM file of the area. Without it nothing is scored."),
      el("li", "The result, here on the map:"),
    ]),
    el(
      "p.row",
      /** @type {const} */ (["right", "wrong", "missed", "unscored"]).map((name) =>
        el("span.key-row", signIcon(name), KEYS[name]),
      ),
    ),
    el("div.row", [
      el("button.primary", { onClick: open }, icon("upload"), "Upload a drive"),
      el("button", { onClick: () => void tryDemo() }, "Try the demo"),
    ]),
    demo.error !== null && problemNote(demo.error),
  ]);
}
