/** Everything of a result to take along: files, a link to this view, the same by curl and in QGIS. */
import { address, download, getConfig, getToken, onTokenChange } from "../api.js";
import { copyButton, resultSection } from "../controls.js";
import { el, fill, icon } from "../dom.js";
import { onResult } from "../map/shown.js";
import { showError } from "../messages.js";
import { permalink, subscribe } from "../state.js";

/** @import { Result } from "../data/results.js" */

/** Layers in a word, in the order of the list; the service has the words that explain them. */
const LAYERS = /** @type {Record<string, string>} */ ({
  intersections: "Intersections",
  detections: "Detections",
  keyframes: "Keyframes",
  trajectory: "Trajectory",
  roads: "Roads seen",
  junctions: "Junctions of roads",
  road_surface: "Road surface",
  osm_nodes: "OSM intersections",
  matches: "Matches",
  osm_roads: "OSM roads",
  osm_buildings: "OSM buildings",
});

/** Layers that an export makes of the intersections. */
const DERIVED = /** @type {Record<string, string>} */ ({
  branches: "Branches, as lines",
  uncertainty: "Uncertainty, as ellipses",
});

/** Ending -> what its button says, of formats that hold one layer. */
const LAYER_FORMATS = { ".fgb": "FGB", ".kml": "KML", ".csv": "CSV", ".parquet": "Parquet" };
const QGZ =
  "All layers in groups, drawn as on this page, in one file that holds the data, too: for QGIS 3.22 and newer.";
const PMTILES = "The intersections as vector tiles, for web maps";
const KMZ = "KMZ: all layers in one file.";
const TIFF =
  "Cells of 0.5 m: from how many keyframes each was seen as road. In UTM, or in metres without georeference.";
const IN_METRES = "Without a georeference the files hold metres of the drive's own frame, without a coordinate system.";
const OF_OSM =
  "Report, verdicts, matches, OSM roads and intersections hold data of OpenStreetMap: © OpenStreetMap contributors, " +
  "ODbL. State this where you publish them.";

/** @param {HTMLElement} container */
export function mount(container) {
  /** @type {Result|null} */
  let result = null;
  const label = "Link to this view";
  const link = el("input", { type: "text", readOnly: true, "aria-label": label, onFocus: () => link.select() });
  const update = () => {
    if (!result) return fill(container, el("p.quiet", "The files appear here when a job is done."));
    fill(container, el("div.stack", sections(result, link)));
  };
  subscribe(null, () => (link.value = permalink()));
  link.value = permalink();
  onTokenChange(update);
  onResult((next) => {
    result = next;
    update();
  });
}

/** @param {Result} result @param {HTMLElement} link */
function sections(result, link) {
  const { job, local, surface } = result;
  const at = `jobs/${job.id}`;
  const slug = job.drive_name.replace(/[^A-Za-z0-9._-]+/g, "_");
  const scored = result.report !== null;
  /** @param {any} text @param {string} path @param {string} name @param {Record<string, string>} [props] */
  const get = (text, path, name, props = { title: `${text}: ${name}` }) =>
    el("button", { ...props, onClick: () => download(path, name).catch(showError) }, text);
  /** @param {any} title @param {...any} buttons */
  const files = (title, ...buttons) => [el("span", title), el("div.formats.row", buttons)];
  /** @param {string} name */
  const vector = (name) => {
    const title = el("span", { title: known.get(name)?.description }, LAYERS[name] ?? DERIVED[name]);
    const path = name.replaceAll("_", "-");
    const others = Object.entries(LAYER_FORMATS)
      .filter(([ending]) => exports.includes(ending) && !(local && ending === ".kml"))
      .map(([ending, text]) => get(text, `${at}/export${ending}?layer=${path}`, `${slug}-${name}${ending}`));
    if (local) return files(title, get("JSON", `${at}/files/${name}.local.json`, `${slug}-${name}.local.json`), others);
    const geojson = name in DERIVED ? `${at}/export.geojson?layer=${path}` : `${at}/${path}`;
    return files(title, get("GeoJSON", geojson, `${slug}-${name}.geojson`), others);
  };
  const raster = () =>
    files(el("span", { title: TIFF }, "Road seen by LiDAR"), get("GeoTIFF", `${surface}.tif`, `${slug}-road.tif`));
  const { exports } = getConfig(); // not every service has all of them
  const known = new Map(getConfig().layers.map((layer) => [layer.name, layer]));
  const hasBuildings = result.buildings.length > 0; // few maps have any
  const isThere = (/** @type {string} */ name) =>
    name === "osm_buildings" ? hasBuildings : scored || !known.get(name)?.is_osm;
  const layers = Object.keys(LAYERS).filter(isThere);
  if (!local) layers.push(...Object.keys(DERIVED));
  const gpkg = `${at}/export.gpkg`;
  const live = get("project without data", `${at}/export.qgs`, `${slug}.qgs`, { class: "link" });
  const token = getToken() ? ' -H "Authorization: Bearer $INTERLOC_TOKEN"' : "";
  const whole = address(gpkg);
  return [
    el("h2", "Take it along"),
    el("div.row", [
      get([icon("download"), "GeoPackage, all layers"], gpkg, `${slug}.gpkg`, { class: "primary" }),
      get([icon("download"), "QGIS project"], `${at}/export.qgz`, `${slug}.qgz`, { title: QGZ }),
      !local && get([icon("download"), "Google Earth"], `${at}/export.kmz`, `${slug}.kmz`, { title: KMZ }),
      get([icon("download"), "Everything (.zip)"], `${at}/archive.zip`, `${slug}.zip`, {}),
      !local && get([icon("download"), "PMTiles"], `${at}/export.pmtiles`, `${slug}.pmtiles`, { title: PMTILES }),
    ]),
    local && el("p.note", IN_METRES),
    resultSection("Layers", el("div.downloads", layers.map(vector), surface && raster())),
    resultSection("Report", [
      el("div.downloads", [
        scored &&
          files(
            "Report",
            get("HTML", `${at}/report?format=html`, `${slug}-report.html`),
            get("JSON", `${at}/report?format=json`, `${slug}-report.json`),
          ),
        files("Settings, versions, timings", get("JSON", `${at}/run`, `${slug}-run.json`)),
      ]),
    ]),
    resultSection(
      "Link to this view",
      el("div.row", el("div.grow", link), copyButton("Copy", permalink)),
      el("p.small", "Drive, job, place, keyframe, layers and filter; for everybody who can reach this server."),
    ),
    resultSection("The same by curl", codeBox(`curl -fOJ${token} ${whole}`)),
    !local && resultSection("In QGIS", qgis(address(`${at}/intersections`), live)),
    scored && !result.isMadeUp && el("p.small.section", OF_OSM),
  ];
}

/**
 * @param {string} geojson Address of a layer.
 * @param {HTMLElement} live Button of the project that reads the layers from the service.
 */
function qgis(geojson, live) {
  const words = "Double-click the project, or drag the GeoPackage into QGIS: the layers are drawn as on this page.";
  const open = el("p.small", words);
  if (getToken()) return open;
  const path = "Layer › Add Layer › Add Vector Layer, source type “Protocol: HTTP(S)”, type GeoJSON, URI:";
  const here = el("p.small", "Read from this server, nothing to download: the ", live, ". One layer: ", path);
  return el("div.stack", open, el("div", here, codeBox(geojson)));
}

/** @param {string} text */
function codeBox(text) {
  const code = el("pre.code.box", { tabIndex: 0 }, text);
  const copy = copyButton("Copy", () => text);
  return el("div.code-box", code, copy);
}
