/**
 * A map of many drives: its intersections and what OpenStreetMap seems to have wrong, asked for by the box that is seen,
 * and the tracks of its drives: a click opens one.
 */
import { factList } from "../controls.js";
import { cities, featuresIn, judge, loadMembers, loadVerdicts, stepFinding, takeBack } from "../data/city.js";
import { lists, titleOf } from "../data/lists.js";
import { lineOf, loadRoads } from "../data/results.js";
import { el, formatCount, formatDate, formatMetres, formatPercent, groupBy, plural } from "../dom.js";
import { showError } from "../messages.js";
import { getState, setState } from "../state.js";
import { kindName, PLACE_SIGNS, partsOf, placeSign, signOfChange } from "./city_places.js";
import { popupOf } from "./details.js";
import { branchesOf, coordinates, waysOut } from "./facts.js";
import { beginTexts, fill, nearestOn, project, stroke, strokePaths, writeText } from "./paths.js";
import { paintRoads, roadsOf } from "./roads.js";
import { paintSigns, SIGNS, trace } from "./symbols.js";

/** @import { City, Member } from "../data/city.js" */
/** @import { View } from "./surface.js" */
/** @typedef {{sign: string, lng: number, lat: number, x: number, y: number, properties: any, finding: any, changes: any[]}} Spot */
/**
 * @typedef {object} Item A drive. Places are those at zoom 0.
 * @property {string} id
 * @property {string} name
 * @property {string|null} job That stands for it.
 * @property {string} text What is known of it.
 * @property {number[][]} track Longitude, latitude.
 * @property {Float64Array} path
 * @property {[number, number]} middle
 * @property {[number, number, number, number]} box Of the path: left, top, right, bottom.
 * @property {string} label
 * @property {number} width Of the label, pixels; 0 until it is known.
 */

const MAX_PLACES = 1000; // at once; of more each part of the view shows some
const PARTS = 3; // along each side
const MAX_TRACKS = 100;
const AROUND = 0.2; // of the view, so that a small move asks for nothing
const CLOSE_ZOOM = 18;
const REACH_PX = 10;
const SMALL_PX = 16; // a track that is smaller is a disc
const ROADS_FROM_ZOOM = 12;
const MAX_ROADS = 20; // drives whose roads are drawn
const NAME_PX = 16;

/** Painted as a scene is; see `Scene`. */
export class CityScene {
  /** What scenes of results have, too. */
  result = { local: false };
  /** @type {Set<string>} */
  on = new Set();
  progress = 0;
  hasTiles = false;

  /** @type {Item[]} */
  items = [];
  /** @type {Spot[]} */
  spots = [];
  /** Under the pointer. @type {Item|null} */
  under = null;
  /** By the job that they were read for. @type {Map<string|null, import("./roads.js").Road[]>} */
  roads = new Map();
  isNew = true;
  /** What of the view is not shown, in words. */
  cut = "";
  /** What was asked for. @type {{box: number[], isWhole: boolean, zoom: number}|null} */
  asked = null;
  /** By their names on the map. @type {Promise<Map<string, Member>>|null} */
  members = null;
  /** What was said of findings. @type {Promise<void>|null} */
  verdicts = null;
  /** @type {AbortController|null} */
  asking = null;

  /**
   * @param {City} city
   * @param {any} map
   * @param {(isFirst: boolean) => void} onChange Called when there is something else to draw.
   */
  constructor(city, map, onChange) {
    this.city = city;
    this.map = map;
    this.onChange = onChange;
  }

  /** The map has changed. @param {City} city */
  renew(city) {
    this.city = city;
    this.asked = null;
    this.members = this.verdicts = null;
    this.look();
  }

  /** Ask for what lies in the view, where it is not there yet. */
  look() {
    const bounds = this.map.getBounds();
    const zoom = this.map.getZoom();
    const inside = boxOf(bounds);
    const { asked } = this;
    if (asked && (asked.isWhole || zoom <= asked.zoom) && holds(asked.box, inside)) return;
    this.asking?.abort();
    this.asking = new AbortController();
    const next = { box: boxOf(bounds.pad(AROUND)), isWhole: false, zoom };
    this.asked = next;
    this.#load(next, this.asking.signal).catch((error) => {
      if (next !== this.asked) return; // another view is asked for by now
      this.asked = this.members = this.verdicts = null; // all of it is asked for again
      showError(error);
    });
  }

  /** @param {NonNullable<CityScene["asked"]>} asked @param {AbortSignal} signal */
  async #load(asked, signal) {
    const { id, findings: count } = this.city;
    const isCompared = count !== null;
    const more = () => {
      this.members ??= loadMembers(id).then((all) => new Map(all.map((each) => [each.label ?? "", each])));
      if (isCompared) this.verdicts ??= loadVerdicts(id);
      return Promise.all([
        featuresIn(id, "changes", asked.box, { limit: MAX_PLACES, signal }),
        isCompared ? featuresIn(id, "findings", asked.box, { limit: MAX_PLACES, signal }) : { features: [] },
        this.members,
        this.verdicts,
      ]);
    };
    const rest = this.isNew ? null : more();
    rest?.catch(() => {}); // it is told below, where somebody still waits
    const [places, tracks] = await Promise.all([
      this.#places(asked.box, signal),
      featuresIn(id, "drives", asked.box, { limit: MAX_TRACKS, signal }),
    ]);
    const show = (
      /** @type {any[]} */ changes,
      /** @type {any[]} */ findings,
      /** @type {Map<string, Member>} */ members,
    ) => {
      this.items = tracks.features.map((each) => this.#itemOf(each, members));
      this.spots = this.#spots(places.features, changes, findings, isCompared);
      this.onChange(this.isNew);
      this.isNew = false;
    };
    if (signal.aborted) return;
    asked.isWhole = places.features.length >= places.matched && tracks.features.length >= tracks.matched;
    this.cut = [cutText("intersections", places), cutText("tracks", tracks)].filter(Boolean).join(", ");
    if (!rest) show([], [], new Map()); // seen before what there is to say of them is asked for
    const [changes, findings, members] = await (rest ?? more());
    if (signal.aborted) return;
    show(changes.features, findings.features, members);
    this.loadRoads();
  }

  /** @param {number[]} box @param {AbortSignal} signal */
  async #places(box, signal) {
    const { id, intersections, bbox } = this.city;
    const isLarge = intersections > MAX_PLACES; // then they are counted first
    const whole = await featuresIn(id, "city", box, { limit: isLarge ? 1 : MAX_PLACES, signal });
    if (whole.matched <= whole.features.length) return whole;
    if (whole.matched <= MAX_PLACES) return featuresIn(id, "city", box, { limit: MAX_PLACES, signal });
    const limit = Math.ceil(MAX_PLACES / PARTS ** 2);
    const some = await Promise.all(
      partsOf(bbox ? overlap(box, bbox) : box, PARTS).map((each) => featuresIn(id, "city", each, { limit, signal })),
    );
    const known = new Map(some.flatMap(({ features }) => features.map((each) => [each.id, each])));
    return { features: [...known.values()], matched: whole.matched };
  }

  /** @param {any[]} places @param {any[]} changes @param {any[]} findings @param {boolean} isCompared @returns {Spot[]} */
  #spots(places, changes, findings, isCompared) {
    const [found, changed] = [findings, changes].map((each) => groupBy(each, ({ properties }) => properties.uid));
    /** @param {any} feature @param {string} sign @param {any} [finding] @param {any[]} [own] @returns {Spot} */
    const spot = ({ geometry, properties }, sign, finding = null, own = []) => {
      const [lng, lat] = geometry.coordinates;
      const [x, y] = project(this.map, [[lng, lat]]);
      return { sign, lng, lat, x, y, properties, finding, changes: own };
    };
    const known = new Set(places.map(({ properties }) => properties.uid));
    const isAlone = (/** @type {any} */ { properties }) => !known.has(properties.uid);
    const alone = findings.filter(isAlone);
    const gone = changes.filter((each) => isAlone(each) && !found.has(each.properties.uid));
    const all = [
      ...gone.map((each) => spot(each, signOfChange(each), null, [each])),
      ...places.map((each) => {
        const { uid, passes } = each.properties;
        const finding = found.get(uid)?.[0].properties ?? null;
        return spot(each, placeSign(passes, finding && verdictOn(finding), isCompared), finding, changed.get(uid));
      }),
      ...alone.map((each) =>
        spot(each, placeSign(0, verdictOn(each.properties), true), each.properties, changed.get(each.properties.uid)),
      ),
    ];
    const signs = Object.keys(PLACE_SIGNS);
    return all.sort((a, b) => signs.indexOf(a.sign) - signs.indexOf(b.sign));
  }

  /**
   * @param {any} feature Of the layer `drives`.
   * @param {Map<string, Member>} members
   * @returns {Item}
   */
  #itemOf({ id: name, geometry, properties: { intersections } }, members) {
    const member = members.get(name);
    const job = lists.jobs.find(({ id }) => id === member?.job_id);
    const track = lineOf(geometry);
    const path = project(this.map, track);
    const half = 2 * Math.floor(path.length / 4);
    const called = member?.name ?? name;
    return {
      id: member?.drive_id ?? "",
      name: called,
      job: member?.job_id ?? null,
      text: [plural(intersections, "intersection"), job && titleOf(job)].filter(Boolean).join(", "),
      track,
      path,
      middle: [path[half], path[half + 1]],
      box: boxOfPath(path),
      label: called.length > 28 ? `${called.slice(0, 27)}…` : called,
      width: 0,
    };
  }

  /** Fetch the roads of the maps that its drives were scored against, each once. */
  loadRoads() {
    const jobs = new Set(this.items.map(({ job }) => job));
    for (const id of this.roads.keys()) if (!jobs.has(id)) this.roads.delete(id);
    for (const job of lists.jobs) {
      if (!jobs.has(job.id) || !job.summary?.report || this.roads.has(job.id) || this.roads.size >= MAX_ROADS) continue;
      this.roads.set(job.id, []);
      loadRoads(job).then((lines) => {
        if (!this.roads.has(job.id)) return;
        this.roads.set(job.id, roadsOf(this.map, lines));
        this.onChange(false);
      }, showError);
    }
  }

  /** What lies below the tracks. @param {CanvasRenderingContext2D} context @param {View} view */
  paintGround(context, view) {
    if (!this.on.has("roads") || view.zoom < ROADS_FROM_ZOOM) return;
    context.lineCap = context.lineJoin = "round";
    const roads = [...this.roads.values()].flat();
    paintRoads(
      context,
      view,
      roads.sort((a, b) => a.width - b.width),
    );
  }

  /** @param {CanvasRenderingContext2D} context @param {View} view */
  #paintTracks(context, view) {
    context.lineCap = context.lineJoin = "round";
    const seen = this.items.filter((item) => isSeen(item, view));
    const lines = seen.filter((item) => !isSmall(item, view));
    const others = lines.filter((item) => item !== this.under);
    strokePaths(
      context,
      view,
      others.map(({ path }) => path),
      "--accent",
      2.5,
    );
    if (this.under && lines.includes(this.under)) strokePaths(context, view, [this.under.path], "--accent", 5);
    context.beginPath();
    for (const item of seen)
      if (isSmall(item, view)) trace(context, "disc", view.x(item.middle[0]), view.y(item.middle[1]), 6);
    fill(context, "--accent");
    stroke(context, "--surface", 2);
  }

  /** Somebody has said something of a finding. */
  judged() {
    for (const spot of this.spots) if (spot.finding) spot.sign = placeSign(0, verdictOn(spot.finding), true);
  }

  /** @param {CanvasRenderingContext2D} context @param {View} view */
  paint(context, view) {
    this.#paintTracks(context, view);
    const r = view.zoom > 15 ? 8 : view.zoom > 13 ? 5 : 3;
    /** @param {string} name @param {number} size @param {(spot: Spot) => boolean} isOne */
    const paintAll = (name, size, isOne) => {
      const seen = this.spots.filter(isOne).map((each) => [view.x(each.x), view.y(each.y)]);
      const spots = seen.filter(([x, y]) => view.shows(x, y));
      paintSigns(context, SIGNS[name], spots, size);
    };
    for (const name of Object.keys(PLACE_SIGNS)) paintAll(name, r, ({ sign }) => sign === name);
    for (const name of ["here", "elsewhere"])
      paintAll(
        name,
        1.6 * r,
        ({ sign, changes }) => sign !== name && changes.some((each) => signOfChange(each) === name),
      );
    paintNames(
      context,
      view,
      this.items.filter((item) => isSeen(item, view)),
      this.spots,
    );
    const { entry } = cities;
    if (!entry) return;
    const [x, y] = project(this.map, [[entry.lon, entry.lat]]);
    context.beginPath();
    trace(context, "ring", view.x(x), view.y(y), r + 9);
    stroke(context, "--ink", 3);
  }

  /** @param {View} view @param {number} x Pixels. @param {number} y @returns {any} The nearest place, else the nearest drive. */
  at(view, x, y) {
    let nearest = null;
    let min = REACH_PX;
    for (const spot of this.spots) {
      const away = Math.hypot(view.x(spot.x) - x, view.y(spot.y) - y);
      if (away <= min) [nearest, min] = [spot, away];
    }
    if (nearest) return { kind: "place", item: nearest };
    for (const item of this.items) {
      if (!isSeen(item, view)) continue;
      const [dx, dy] = [view.x(item.middle[0]) - x, view.y(item.middle[1]) - y];
      const away = isSmall(item, view) ? Math.hypot(dx, dy) : nearestOn(item.path, view, x, y).away;
      if (away <= min) [nearest, min] = [item, away];
    }
    return nearest && { kind: "drive", item: nearest };
  }

  /** @param {any} hit What is under the pointer is drawn above the others. */
  lift(hit) {
    this.under = hit;
    return true;
  }

  /** @param {any} hit */
  tipOf({ kind, item }) {
    if (kind === "drive") return el("div", el("strong", item.name), el("br"), item.text);
    return el("div", [
      el("strong", spotTitle(item)),
      el("br"),
      item.finding?.text ?? (item.properties.passes ? seenText(item.properties) : changeText(item.properties)),
    ]);
  }

  /** @param {any} hit */
  open({ kind, item }) {
    const { id, job } = item;
    if (kind === "drive")
      return setState({ drive: id, job, frame: null, view: null, panel: job ? "result" : "drives" });
    if (item.finding) return setState({ panel: "map", finding: item.finding.id });
    popupOf(this.map, item, contentOf(item)).openOn(this.map);
  }

  /** Go to the finding that is looked at. @param {boolean} [animate] */
  goToEntry(animate = !matchMedia("(prefers-reduced-motion: reduce)").matches) {
    const { entry } = cities;
    if (!entry) return;
    this.map.closePopup();
    this.map.setView([entry.lat, entry.lon], Math.max(this.map.getZoom(), CLOSE_ZOOM), { animate });
  }
}

/** @param {string} name @param {{features: any[], matched: number}} found @returns {string} Empty where all are there. */
const cutText = (name, { features, matched }) =>
  features.length < matched ? `${formatCount(features.length)} of ${formatCount(matched)} ${name}` : "";

/** @param {any} finding Properties of the layer `findings`. @returns {{verdict: string|null}} */
const verdictOn = ({ id }) => ({ verdict: cities.verdicts.get(id) ?? null });

/** @param {Spot} spot */
const spotTitle = ({ finding, properties }) => (finding ? kindName(finding.kind) : `Intersection ${properties.uid}`);

/** @param {any} properties Of the layer `city`. */
const seenText = ({ drives, drives_near, passes }) =>
  `seen by ${drives} of ${plural(drives_near, "drive")} that came near, in ${plural(passes, "pass", "passes")}`;

/** @param {Spot} spot */
function contentOf({ lat, lng, properties: p, changes }) {
  const change = changes.map(({ properties: c }) => el("p.why", changeText(c)));
  return el("div.details", [
    el("h3", `Intersection ${p.uid}`),
    change,
    factList("", [...(p.passes ? seenFacts(p) : []), ["Latitude, longitude", coordinates({ lat, lng }, false)]]),
    el("div.row", waysOut({ lat, lng })),
  ]);
}

/** @param {any} p Properties of the layer `city`. @returns {([string, any]|null)[]} */
const seenFacts = (p) => [
  ["Drives", `${p.drives} of ${p.drives_near} that came near`],
  ["Passes", String(p.passes)],
  ["Confidence", formatPercent(p.confidence)],
  ["Uncertainty (1 σ)", formatMetres(p.position_std_m)],
  ["In its surroundings", formatMetres(p.relative_std_m)],
  ...branchesOf(p, false).map((each) => each || null),
  p.first_time && ["Seen", [p.first_time, p.last_time].map((each) => formatDate(each)).join(" to ")],
  ["By", p.drive_names],
];

/** @param {any} change Properties of the layer `changes`. */
const changeText = ({ kind, bearing_deg, seen_by, not_seen_by }) =>
  `${kindName(kind)}${bearing_deg === null ? "" : ` at ${Math.round(bearing_deg)}°`}: seen by ${seen_by}, not by ${not_seen_by}.`;

/** @param {any} bounds Of Leaflet. @returns {number[]} West, south, east, north, on the Earth. */
function boxOf(bounds) {
  const within = (/** @type {number} */ value, /** @type {number} */ max) => Math.max(-max, Math.min(max, value));
  const [west, east] = [bounds.getWest(), bounds.getEast()].map((each) => within(each, 180));
  return [west, within(bounds.getSouth(), 90), east, within(bounds.getNorth(), 90)];
}

/** @param {number[]} a @param {number[]} b @returns {number[]} What lies in both. */
const overlap = (a, b) => a.map((each, i) => (i < 2 ? Math.max(each, b[i]) : Math.min(each, b[i])));

/** @param {number[]} box @param {number[]} inside */
const holds = (box, inside) => box[0] <= inside[0] && box[1] <= inside[1] && box[2] >= inside[2] && box[3] >= inside[3];

let isJudging = false;
/** @param {() => Promise<any>} call @returns {() => void} Done where the queue is on the page. */
const inQueue = (call) => () => getState().panel === "map" && void call().catch(showError);
/** @param {() => Promise<any>} call @returns {() => void} The same, one after the other. */
const onceInQueue = (call) =>
  inQueue(async () => {
    if (isJudging) return;
    isJudging = true;
    await call().finally(() => (isJudging = false));
  });

/** What was seen, in the order of its keys. @type {[verdict: import("../data/city.js").Verdict, name: string, hint: string][]} */
export const VERDICTS = [
  ["right", "Right", "OpenStreetMap is wrong here"],
  ["wrong", "Wrong", "OpenStreetMap is right: the place never comes back"],
  ["cannot_tell", "Cannot tell", "Nobody can tell from what there is"],
  ["fixed", "Fixed", "It was wrong, and has been mended"],
];

/** Keys of the queue, for the list of shortcuts. */
export const CITY_KEYS = [
  { key: "j", text: "Next finding of the map", run: inQueue(() => stepFinding(1)) },
  { key: "k", text: "Previous finding of the map", run: inQueue(() => stepFinding(-1)) },
  ...VERDICTS.map(([verdict, name], i) => ({
    key: String(i + 1),
    text: `Say of the finding: ${name.toLowerCase()}`,
    run: onceInQueue(() => judge(verdict)),
  })),
  { key: "u", text: "Take the last verdict on a finding back", run: onceInQueue(takeBack) },
];

/** As many names as have room beside signs. @param {CanvasRenderingContext2D} context @param {View} view @param {Item[]} items @param {{x: number, y: number}[]} signs At zoom 0. */
function paintNames(context, view, items, signs) {
  beginTexts(context, "bottom", "--ink");
  /** @type {Map<number, [number, number, number][]>} Left, bottom, width; by rows of the map. */
  const taken = new Map();
  for (const { x, y } of signs) {
    const bottom = view.y(y) + NAME_PX / 2;
    const row = Math.floor(bottom / NAME_PX);
    taken.set(row, [...(taken.get(row) ?? []), [view.x(x) - NAME_PX / 2, bottom, NAME_PX]]);
  }
  for (const item of items) {
    const x = view.x(item.middle[0]);
    const top = view.y(item.middle[1]) - 9;
    if (!view.shows(x, top)) continue;
    item.width ||= context.measureText(item.label).width;
    const left = x - item.width / 2;
    const isFree = (/** @type {number} */ y) => {
      const row = Math.floor(y / NAME_PX);
      const near = [row - 1, row, row + 1].flatMap((each) => taken.get(each) ?? []);
      return !near.some(([l, b, w]) => left < l + w + 4 && l < left + item.width + 4 && Math.abs(y - b) < NAME_PX);
    };
    const y = [top, top - NAME_PX, top + 2 * NAME_PX].find(isFree); // drives through one street have one middle
    if (y === undefined) continue;
    const row = Math.floor(y / NAME_PX);
    taken.set(row, [...(taken.get(row) ?? []), [left, y, item.width]]);
    writeText(context, item.label, x, y);
  }
}

/** @param {Float64Array} path @returns {[number, number, number, number]} */
function boxOfPath(path) {
  let [left, top, right, bottom] = [Infinity, Infinity, -Infinity, -Infinity];
  for (let i = 0; i < path.length; i += 2) {
    left = Math.min(left, path[i]);
    right = Math.max(right, path[i]);
    top = Math.min(top, path[i + 1]);
    bottom = Math.max(bottom, path[i + 1]);
  }
  return [left, top, right, bottom];
}

/** @param {Item} item @param {View} view @returns {boolean} Whether something of it may be on the canvas. */
function isSeen({ box: [left, top, right, bottom] }, view) {
  const { x: width, y: height } = view.size;
  return (
    view.x(right) > -SMALL_PX &&
    view.x(left) < width + SMALL_PX &&
    view.y(bottom) > -SMALL_PX &&
    view.y(top) < height + SMALL_PX
  );
}

/** @param {Item} item @param {View} view */
function isSmall({ box: [left, top, right, bottom] }, view) {
  return Math.max(right - left, bottom - top) * view.scale < 2 * SMALL_PX;
}
