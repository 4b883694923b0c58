/**
 * Everything of a result to take along: files, a link to this view, the same by curl and in QGIS.
 * @module exports/panel
 */
import { address, download, getToken, onTokenChange } from "../api.js";
import { el, fill, icon } from "../dom.js";
import { onResult } from "../map/shown.js";
import { showError } from "../shell/messages.js";
import { permalink, subscribe } from "../state.js";

/** @param {HTMLElement} container */
export function mount(container) {
  /** @type {import("../data/results.js").Result|null} */
  let result = null;
  const link = el("input", {
    type: "text",
    readOnly: true,
    "aria-label": "Link to this view",
    onFocus: () => link.select(),
  });
  const update = () => {
    if (!result) return fill(container, el("p", { class: "quiet" }, "The files appear here when a job is done."));
    fill(container, el("div", { class: "stack" }, sections(result, link)));
  };
  subscribe(null, () => (link.value = permalink()));
  link.value = permalink();
  onTokenChange(update);
  onResult((next) => {
    result = next;
    update();
  });
}

/** @param {import("../data/results.js").Result} result @param {HTMLElement} link */
function sections(result, link) {
  const at = `jobs/${result.job.id}`;
  const slug = result.job.drive_name.replace(/[^A-Za-z0-9._-]+/g, "_");
  const scored = result.report !== null;
  /** @param {string} text @param {string} path @param {string} name */
  const get = (text, path, name) =>
    el("button", { title: `${text}: ${name}`, onClick: () => download(path, name).catch(showError) }, text);
  /** @param {string} title @param {string} layer @param {string} file */
  const vector = (title, layer, file) => [
    el("span", {}, title),
    el(
      "div",
      { class: "formats" },
      result.local
        ? get("JSON", `${at}/files/${file}.local.json`, `${slug}-${file}.local.json`)
        : get("GeoJSON", `${at}/${layer}`, `${slug}-${file}.geojson`),
      !result.local &&
        ["fgb", "kml"].map((format) =>
          get(format.toUpperCase(), `${at}/export.${format}?layer=${layer}`, `${slug}-${file}.${format}`),
        ),
    ),
  ];
  const gpkg = address(`${at}/export.gpkg`);
  const geojson = address(`${at}/intersections`);
  const token = getToken() ? ' -H "Authorization: Bearer $INTERLOC_TOKEN"' : "";
  return [
    el("h2", {}, "Take it along"),
    el(
      "div",
      { class: "row" },
      !result.local &&
        el(
          "button",
          { class: "primary", onClick: () => download(`${at}/export.gpkg`, `${slug}.gpkg`).catch(showError) },
          icon("download"),
          "GeoPackage, all layers",
        ),
      el(
        "button",
        { onClick: () => download(`${at}/archive.zip`, `${slug}.zip`).catch(showError) },
        icon("download"),
        "Everything (.zip)",
      ),
    ),
    result.local &&
      el(
        "p",
        { class: "note" },
        "Without a georeference the files hold metres of the drive’s own frame; there are no GIS formats of them.",
      ),
    el(
      "section",
      { class: "section" },
      el("h3", {}, "Layers"),
      el(
        "div",
        { class: "downloads" },
        vector("Intersections", "intersections", "intersections"),
        vector("Detections", "detections", "detections"),
        vector("Keyframes", "keyframes", "keyframes"),
        vector("Trajectory", "trajectory", "trajectory"),
        scored && [vector("OSM intersections", "osm-nodes", "osm_nodes"), vector("Matches", "matches", "matches")],
      ),
    ),
    el(
      "section",
      { class: "section" },
      el("h3", {}, "Report"),
      el(
        "div",
        { class: "downloads" },
        scored && [
          el("span", {}, "Report"),
          el(
            "div",
            { class: "formats" },
            get("HTML", `${at}/report?format=html`, `${slug}-report.html`),
            get("JSON", `${at}/report?format=json`, `${slug}-report.json`),
          ),
        ],
        [
          el("span", {}, "Settings, versions, timings"),
          el("div", { class: "formats" }, get("JSON", `${at}/run`, `${slug}-run.json`)),
        ],
      ),
    ),
    el(
      "section",
      { class: "section" },
      el("h3", {}, "Link to this view"),
      el(
        "div",
        { class: "row" },
        el("div", { class: "grow" }, link),
        copyButton(() => permalink()),
      ),
      el("p", { class: "small" }, "Drive, job, place, keyframe and layers; for whoever can reach this server."),
    ),
    el(
      "section",
      { class: "section stack-s" },
      el("h3", {}, "The same by curl"),
      codeBox(`curl -fOJ${token} ${result.local ? address(`${at}/archive.zip`) : gpkg}`),
    ),
    !result.local &&
      el(
        "section",
        { class: "section stack-s" },
        el("h3", {}, "In QGIS"),
        getToken()
          ? el(
              "p",
              { class: "small" },
              "Download the GeoPackage and drag it into QGIS: this server wants a token, which QGIS does not send by itself.",
            )
          : [
              el(
                "p",
                { class: "small" },
                "Layer › Add Layer › Add Vector Layer, source type “Protocol: HTTP(S)”, type GeoJSON, URI:",
              ),
              codeBox(geojson),
            ],
      ),
    scored &&
      el(
        "p",
        { class: "small section" },
        "Report, matches and OSM intersections hold data of OpenStreetMap: © OpenStreetMap contributors, ODbL. Say so where you publish them.",
      ),
  ];
}

/** @param {string} text */
function codeBox(text) {
  return el(
    "div",
    { class: "code-box" },
    el("pre", { class: "code", tabIndex: 0 }, text),
    copyButton(() => text),
  );
}

/** @param {() => string} text */
function copyButton(text) {
  const button = el("button", { onClick: () => void copy() }, icon("copy"), "Copy");
  const copy = async () => {
    try {
      await navigator.clipboard.writeText(text());
    } catch {
      const area = el("textarea", { value: text(), class: "unseen" }); // plain http has no clipboard of its own
      document.body.append(area);
      area.select();
      document.execCommand("copy");
      area.remove();
    }
    fill(button, icon("check"), "Copied");
    setTimeout(() => fill(button, icon("copy"), "Copy"), 1500);
  };
  return button;
}
