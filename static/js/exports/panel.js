/** Everything of a result to take along: files, the same by curl and in QGIS. */
import { address, download, getConfig, getToken, onTokenChange } from "../api.js";
import { copyButton, resultSection, select } from "../controls.js";
import { el, fill, icon } from "../dom.js";
import { onResult } from "../map/shown.js";
import { showError } from "../messages.js";

/** @import { Result } from "../data/results.js" */

/** Layers in a word, in the order of the list; the service has the words that explain them. */
const LAYERS = /** @type {Record<string, string>} */ ({
  intersections: "Intersections",
  roads: "Roads seen",
  trajectory: "Trajectory",
  osm_nodes: "OSM intersections",
  detections: "Detections",
  keyframes: "Keyframes",
  junctions: "Junctions of roads",
  road_surface: "Road surface",
  matches: "Matches",
  osm_roads: "OSM roads",
  osm_buildings: "OSM buildings",
});

/** Layers that an export makes of the intersections. */
const DERIVED = /** @type {Record<string, string>} */ ({
  branches: "Branches, as lines",
  uncertainty: "Uncertainty, as ellipses",
});

/** Ending -> name, of formats that hold one layer. */
const LAYER_FORMATS = {
  ".geojson": "GeoJSON",
  ".fgb": "FlatGeobuf",
  ".kml": "KML",
  ".csv": "CSV",
  ".parquet": "GeoParquet",
};
const MAIN = "Intersections, roads, trajectory and the intersections of OpenStreetMap";
const OF_DEGREES = new Set([".geojson", ".kml"]);
const QGZ =
  "All layers in groups, drawn as on this page, in one file that holds the data, too: for QGIS 3.22 and newer.";
const IN_METRES = "Without a georeference the files hold metres of the drive's own frame, without a coordinate system.";
const OF_OSM =
  "Report, verdicts, matches, OSM roads and intersections hold data of OpenStreetMap: © OpenStreetMap contributors, " +
  "ODbL. State this where you publish them.";

/** Path of an export, below the job. @param {string} ending @param {string} [layer] */
const exported = (ending, layer) => `export?f=${ending.slice(1)}${layer ? `&layer=${layer}` : ""}`;

/** @param {HTMLElement} container */
export function mount(container) {
  /** @type {Result|null} */
  let result = null;
  const update = () => {
    if (!result) return fill(container, el("p.quiet", "The files appear here when a job is done."));
    fill(container, el("div.stack", sections(result)));
  };
  onTokenChange(update);
  onResult((next) => {
    result = next;
    update();
  });
}

/** @typedef {{title: string, path: string, name: string}} Format `path`: below the job; `name`: of the file. */

/**
 * @param {Result} result
 * @param {string} slug
 * @returns {Record<string, {title: string, formats: Format[]}>} What can be had alone, and in which formats.
 */
function partsOf({ local, surface, buildings, report }, slug) {
  const { exports, layers } = getConfig(); // not every service has all of them
  const isOfOsm = new Set(layers.filter(({ is_osm }) => is_osm).map(({ name }) => name));
  const isThere = (/** @type {string} */ name) =>
    name === "osm_buildings" ? buildings.length > 0 : report !== null || !isOfOsm.has(name);
  const file = (/** @type {string} */ title, /** @type {string} */ path, /** @type {string} */ name) => [
    { title, path, name: `${slug}-${name}` },
  ];
  /** @param {string} name @returns {Format[]} */
  const formatsOf = (name) => {
    const written = Object.entries(LAYER_FORMATS).filter(([ending]) => exports.includes(ending));
    const fit = written.filter(([ending]) => !(local && OF_DEGREES.has(ending)));
    return [
      ...(local ? file("JSON", `files/${name}.local.json`, `${name}.local.json`) : []),
      ...fit.flatMap(([ending, title]) => file(title, exported(ending, name), `${name}${ending}`)),
      ...(name === "intersections" && !local ? file("PMTiles, for web maps", exported(".pmtiles"), "map.pmtiles") : []),
    ];
  };
  const names = Object.entries({ ...LAYERS, ...(local ? {} : DERIVED) }).filter(([name]) => isThere(name));
  return {
    ...Object.fromEntries(names.map(([name, title]) => [name, { title, formats: formatsOf(name) }])),
    ...(surface && { road: { title: "Road seen by LiDAR", formats: file("GeoTIFF", "files/road.tif", "road.tif") } }),
    all: {
      title: "All layers",
      formats: [
        ...file("GeoPackage", exported(".gpkg", "all"), "all.gpkg"),
        ...(local ? [] : file("KMZ, for Google Earth", exported(".kmz", "all"), "all.kmz")),
      ],
    },
    ...(report && { report: { title: "Report", formats: file("JSON", "report", "report.json") } }),
    run: { title: "Settings, versions, timings", formats: file("JSON", "files/run.json", "run.json") },
  };
}

/** @param {string} at Path of the job. @param {ReturnType<typeof partsOf>} parts @returns {HTMLElement} One of them, in one format. */
function chooser(at, parts) {
  const formats = el("div.grow");
  /** @type {HTMLSelectElement} */
  let format;
  const choose = (/** @type {string} */ part) => {
    format = select(
      Object.fromEntries(parts[part].formats.map(({ title }, i) => [i, title])),
      "0",
      undefined,
      "Format",
    );
    fill(formats, format);
  };
  const titles = Object.fromEntries(Object.entries(parts).map(([part, { title }]) => [part, title]));
  const part = select(titles, undefined, choose, "Layer");
  choose(part.value);
  const get = () => {
    const { path, name } = parts[part.value].formats[Number(format.value)];
    download(`${at}/${path}`, name).catch(showError);
  };
  return el("div.stack-s", part, el("div.row", formats, el("button", { onClick: get }, icon("download"), "Download")));
}

/** @param {Result} result */
function sections(result) {
  const { job, local } = result;
  const at = `jobs/${job.id}`;
  const slug = job.drive_name.replace(/[^A-Za-z0-9._-]+/g, "_");
  /** @param {any} text @param {string} path @param {string} name @param {Record<string, string>} [props] */
  const get = (text, path, name, props = {}) =>
    el("button", { ...props, onClick: () => download(`${at}/${path}`, name).catch(showError) }, text);
  const token = getToken() ? ' -H "Authorization: Bearer $INTERLOC_TOKEN"' : "";
  return [
    el("h2", "Take it along"),
    el("div.row", [
      get([icon("download"), "GeoPackage"], exported(".gpkg"), `${slug}.gpkg`, { class: "primary", title: MAIN }),
      get([icon("download"), "QGIS project"], exported(".qgz"), `${slug}.qgz`, { title: QGZ }),
      get([icon("download"), "Everything (.zip)"], "archive.zip", `${slug}.zip`),
      result.report && get([icon("download"), "Report"], "report?format=html", `${slug}-report.html`),
    ]),
    local && el("p.note", IN_METRES),
    resultSection("One layer", chooser(at, partsOf(result, slug))),
    resultSection("The same by curl", codeBox(`curl -fOJ${token} ${address(`${at}/export`)}`)),
    !local && resultSection("In QGIS", qgis(address(`${at}/layers/intersections`))),
    result.report && !result.isMadeUp && el("p.small.section", OF_OSM),
  ];
}

/** @param {string} geojson Address of a layer. */
function qgis(geojson) {
  const words = "Double-click the project, or drag the GeoPackage into QGIS: the layers are drawn as on this page.";
  const open = el("p.small", words);
  if (getToken()) return open;
  const path = "Layer › Add Layer › Add Vector Layer, source type “Protocol: HTTP(S)”, type GeoJSON, URI:";
  const here = el("p.small", "Read from this server, nothing to download: one layer by ", path);
  return el("div.stack", open, el("div", here, codeBox(geojson)));
}

/** @param {string} text */
function codeBox(text) {
  const code = el("pre.code.box", { tabIndex: 0 }, text);
  const copy = copyButton("Copy", () => text);
  return el("div.code-box", code, copy);
}
