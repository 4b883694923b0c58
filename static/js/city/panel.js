/**
 * A map of many drives: how far it is, which of it is shown, and the queue of what OpenStreetMap seems to have wrong.
 */
import { address, download, getToken, loadPicture, onTokenChange } from "../api.js";
import {
  bullets,
  copyButton,
  factList,
  figure,
  iconButton,
  outLink,
  resultSection as section,
  select,
} from "../controls.js";
import {
  chosenCity,
  cities,
  judge,
  loadMaps,
  loadQueue,
  onCityChange,
  stepFinding,
  takeBack,
  versionOf,
} from "../data/city.js";
import { announce, el, fill, formatAgo, formatCount, formatMetres, icon, plural } from "../dom.js";
import { VERDICTS } from "../map/city.js";
import { kindName, precisionText, streetsOf } from "../map/city_places.js";
import { problemNote, showError } from "../messages.js";
import { getState, setState, subscribe } from "../state.js";
import { manageDrives, newMap, removeMap } from "./dialogs.js";

/** @import { City, Entry } from "../data/city.js" */

const NAMES = /** @type {Record<string, string>} */ (Object.fromEntries(VERDICTS));
const STATES = { open: "Not looked at", judged: "Looked at", all: "All" };
const LINKS = /** @type {Record<string, string>} */ ({
  osm: "OpenStreetMap",
  id: "iD",
  josm: "JOSM",
  mapillary: "Mapillary",
  panoramax: "Panoramax",
});
/** Files for those who mend maps. */
const DELIVERIES = {
  "maproulette.geojson": [
    "MapRoulette",
    "Tasks of a challenge, at most 1,000; the same finding is the same task again.",
  ],
  "findings.geojson": ["GeoJSON", "With all that is known of each."],
};
/** Files of the map itself. */
const FILES = {
  "city.geojson": ["Intersections", "One point per physical intersection."],
  "drives.geojson": ["Tracks", "Of its drives, their offsets taken away."],
  "changes.geojson": ["Changes", "What came or went between drives."],
};

/** @param {HTMLElement} container */
export function mount(container) {
  const head = el("div.stack-s");
  const queue = el("div.stack-s");
  const more = el("div.stack");
  fill(container, el("div.stack.city", head, queue, more));
  const card = entryCard();
  /** What is shown: version of the map, filter. */
  let shown = "";
  let listed = "";
  const update = () => {
    const city = chosenCity();
    if (!cities.maps || !city) {
      fill(head, cities.maps ? problemNote({ title: "No such map", detail: "It may have been deleted." }) : "Loading…");
      if (cities.maps) head.append(mapChoice(null));
      fill(queue);
      shown = "";
      return fill(more);
    }
    const now = JSON.stringify([city.id, cities.maps, Boolean(getToken())]);
    if (now !== shown) {
      fill(head, headOf(city));
      fill(more, city.bbox && filesOf(city));
    }
    shown = now;
    const wanted = JSON.stringify([versionOf(city), cities.wanted]);
    if (wanted !== listed && city.findings !== null)
      loadQueue(city).catch((error) => {
        listed = ""; // asked for again when the tab is opened
        showError(error);
      });
    listed = wanted;
    const hasQueue = cities.queue?.map === city.id;
    queue.hidden = !hasQueue;
    if (!hasQueue) return;
    card.update();
    fillQueue(queue, city, card.element);
  };
  onCityChange(() => getState().panel === "map" && update());
  onTokenChange(() => {
    cities.readsOnly = false;
    update();
  });
  subscribe(["panel", "map", "finding"], ({ panel }) => panel === "map" && update());
  again = update;
  update();
  if (!cities.maps) loadMaps().catch((error) => fill(head, problemNote(error)));
}

/** Looks at other findings: of the panel. */
let again = () => {};

/** @param {City} city @returns {[text: string, look: string]} */
function stateOf({ is_at_work, is_waiting, problem, bbox }) {
  if (is_at_work) return ["Merging", "busy"];
  if (is_waiting) return ["Waiting", "busy"];
  if (problem) return ["Not compared", "error"];
  return bbox ? ["Up to date", "good"] : ["Empty", ""];
}

/** @param {City|null} city @returns {HTMLElement|null} Nothing where there is one map alone. */
function mapChoice(city) {
  const maps = cities.maps ?? [];
  if (city && maps.length < 2) return el("h2.cut.grow", city.name);
  const choices = Object.fromEntries(maps.map(({ id, name }) => [id, name]));
  const choose = (/** @type {string} */ id) => setState({ map: id === "default" ? null : id });
  const all = city ? choices : { "": "Choose a map", ...choices };
  return el("div.grow", select(all, city?.id ?? "", choose, "Map"));
}

/** @param {City} city */
function headOf(city) {
  const [text, look] = stateOf(city);
  const refused = city.refused > 0 ? `${city.refused} refused` : undefined;
  const source =
    city.osm && `Compared with ${city.osm}: ${plural(city.junctions_passed ?? 0, "junction")} passed often enough.`;
  return [
    el("div.spread", mapChoice(city), el("span", { class: `badge ${look}`, role: "status" }, text)),
    city.bbox &&
      el("div.tiles-row", [
        figure(formatCount(city.intersections), "intersections", `${formatCount(city.seen_by_several)} seen again`),
        figure(formatCount(city.drives), city.drives === 1 ? "drive" : "drives", refused),
        figure(formatMetres(city.median_position_std_m), "uncertainty", "1 σ, median"),
      ]),
    city.problem && problemNote({ title: city.is_waiting ? "Not up to date" : "Not compared", detail: city.problem }),
    source && el("p.small", source),
    el("div.row", [
      el("button", { onClick: () => manageDrives(city).catch(showError) }, "Drives…"),
      el("button", { onClick: () => newMap() }, "New map…"),
      !city.holds_all && iconButton("trash", `Delete the map ${city.name}`, () => removeMap(city).catch(showError)),
    ]),
  ];
}

/** The finding that was scrolled to. @type {string|null} */
let gone = null;

/** @param {HTMLElement} holder @param {City} city @param {HTMLElement} card */
function fillQueue(holder, city, card) {
  const queue = /** @type {NonNullable<typeof cities.queue>} */ (cities.queue);
  const { kind, state } = cities.wanted;
  const kinds = Object.fromEntries(Object.keys(queue.by_kind).map((each) => [each, kindName(each)]));
  const at = queue.entries.findIndex(({ id }) => id === getState().finding);
  const judgedKinds = Object.entries(queue.by_kind).filter(([, each]) => each.right + each.wrong + each.cannot_tell);
  const choose = (/** @type {object} */ wanted) => (Object.assign(cities.wanted, wanted), again());
  const go = (/** @type {1|-1} */ by) => () => void stepFinding(by).catch(showError);
  const previous = iconButton("previous", "Previous finding", go(-1), "Previous finding (k)");
  const next = iconButton("next", "Next finding", go(1), "Next finding (j)");
  const title = el("h3", "What OpenStreetMap seems to have wrong");
  if (!queue.open && !queue.judged) {
    const agrees = city.junctions_passed
      ? "Nothing: it agrees with what the drives saw."
      : "Nothing can be told yet: no junction was passed often enough.";
    const nothing = city.is_waiting ? "The comparison goes on." : agrees;
    return fill(holder, title, el("p.quiet", { role: "status" }, nothing));
  }
  const readMore = () => void loadQueue(city, true).catch(showError);
  const top = holder.querySelector(".scroll")?.scrollTop ?? 0;
  fill(
    holder,
    title,
    el(
      "p.small",
      { role: "status" },
      `${plural(queue.open, "finding")} to look at, ${queue.judged} looked at. ${precisionText(queue.precision)}`,
    ),
    judgedKinds.length > 1 && bullets(judgedKinds.map(([name, each]) => `${kindName(name)}: ${precisionText(each)}`)),
    el("div.tools.spread", [
      select(STATES, state, (value) => choose({ state: value }), "State of the findings"),
      select({ "": "All kinds", ...kinds }, kind, (value) => choose({ kind: value }), "Kind of the findings"),
      previous,
      el("span.number.quiet", `${at < 0 ? "–" : at + 1} / ${queue.entries.length}${queue.next ? "+" : ""}`),
      next,
    ]),
    card,
    queue.entries.length
      ? el("div.drive", el("ul.jobs.scroll", queue.entries.map(entryRow)))
      : el("p.quiet", emptyText(city, state, kind)),
    queue.next && el("button", { onClick: readMore }, "Show more"),
  );
  const list = holder.querySelector(".scroll");
  if (list) list.scrollTop = top;
  if (getState().finding === gone) return;
  gone = getState().finding;
  const row = /** @type {HTMLElement|null} */ (holder.querySelector('[aria-current="true"]'));
  if (row?.offsetParent) row.offsetParent.scrollTop = row.offsetTop; // the list alone
  holder.querySelector(".tools")?.scrollIntoView({ block: "start" }); // the finding stands below it
}

/** @param {City} city @param {string} state @param {string} kind */
function emptyText({ is_waiting }, state, kind) {
  if (kind) return "None of this kind.";
  if (state === "judged") return "Nobody has looked at any yet.";
  return is_waiting ? "The comparison goes on." : "Nothing is left to look at.";
}

/** @param {Entry} entry */
function entryRow({ id, kind, properties, verdict }) {
  const isShown = getState().finding === id;
  const props = { "aria-current": String(isShown), dataset: { key: id }, onClick: () => setState({ finding: id }) };
  const passes = plural(properties?.passes ?? 0, "pass", "passes");
  const button = el("button", props, [
    el("span.cut", streetsOf(properties?.osm_ways) || kindName(kind)),
    verdict ? el("span.badge", NAMES[verdict.verdict]) : el("span.small", passes),
    el("span.small.both", properties?.text ?? `${kindName(kind)}: the last comparison has it no more.`),
  ]);
  return el("li", button);
}

/** The finding that is looked at: what speaks for it, and what was said of it. */
function entryCard() {
  const element = el("article.box.finding.stack-s", { "aria-label": "Finding", hidden: true });
  let shown = "";
  const update = () => {
    const { entry } = cities;
    element.hidden = !entry;
    const now = JSON.stringify([entry, cities.readsOnly]);
    if (!entry || now === shown) return;
    shown = now;
    const p = entry.properties;
    const alt = "The ground around it as the drives saw it: road grey, other ground green, tracks blue";
    const image = entry.picture && el("img", { alt, width: 320, height: 320 });
    if (entry.picture)
      loadPicture(entry.picture.split("/api/v1/")[1]).then(
        (url) => (image.src = url),
        () => image.remove(),
      );
    const streets = streetsOf(p?.osm_ways);
    const links = Object.entries(entry.links).map(([name, href]) => outLink(href, LINKS[name] ?? name));
    fill(
      element,
      el("h4", kindName(entry.kind), streets && `: ${streets}`),
      p && el("p", p.text),
      image,
      p &&
        factList("", [
          ["Passes", `${p.passes}: ${p.drive_names}`],
          p.distance_m !== null && ["Distance", formatMetres(p.distance_m, 1)],
          p.branch_bearings_deg?.length > 0 && [
            "Branches",
            p.branch_bearings_deg.map((/** @type {number} */ b) => `${Math.round(b)}°`).join(", "),
          ],
          p.osm_id !== null && ["OSM node", String(p.osm_id)],
        ]),
      p?.osm_ways && el("details", el("summary", "Ways around"), bullets(p.osm_ways.split("; "))),
      el("p.row.links", links),
      el("p.small", "Keys: j next, k previous, 1 to 4 say what you see, u takes it back."),
      historyOf(entry),
      el(
        "div.verdicts.row",
        { role: "group", "aria-label": "What you see there" },
        VERDICTS.map(([verdict, name, hint], i) => {
          const isSaid = entry.verdict?.verdict === verdict;
          const props = {
            title: hint,
            disabled: cities.readsOnly,
            dataset: { key: verdict },
            onClick: (/** @type {MouseEvent} */ { detail }) => detail < 2 && say(verdict), // the next finding stands there now
          };
          return el("button", { ...props, "aria-pressed": String(isSaid) }, el("kbd", String(i + 1)), name);
        }),
      ),
      cities.readsOnly && el("p.small", "Your token may only read: others say what they see."),
    );
  };
  return { element, update };
}

/** @param {import("../data/city.js").Verdict} verdict */
function say(verdict) {
  judge(verdict).then(() => announce(`${NAMES[verdict]}.`), showError);
}

/** @param {Entry} entry */
function historyOf({ verdict, history }) {
  if (!verdict) return null;
  const rows = history ?? [verdict];
  const onClick = () => void takeBack().catch(showError);
  return el("div.spread", [
    bullets(rows.map(({ verdict: said, by, at }) => `${NAMES[said]}, by ${by}, ${formatAgo(at)}`)),
    el("button.link", { disabled: cities.readsOnly, dataset: { key: "back" }, onClick }, "Take it back"),
  ]);
}

/** @param {City} city */
function filesOf(city) {
  const slug = city.name.replace(/[^A-Za-z0-9._-]+/g, "_");
  /** @param {string} folder @param {Record<string, string[]>} files */
  const rows = (folder, files) =>
    Object.entries(files).map(([name, [title, hint]]) => {
      const get = () => void download(`maps/${city.id}/${folder}/${name}`, `${slug}-${name}`).catch(showError);
      return el("button", { title: hint, onClick: get }, icon("download"), title);
    });
  const gis = address(`maps/${city.id}/ogc`);
  return [
    (city.findings ?? 0) > 0 &&
      section("Findings, for those who mend the map", el("div.row", rows("deliveries", DELIVERIES))),
    section("The map", el("div.row", [rows("files", FILES), copyButton("Address for QGIS", () => gis)])),
  ];
}
