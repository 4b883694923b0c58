/** What is to be done with a drive: the map to score against, the labels to use, the settings of the method. */

import { getConfig, newKey } from "../api.js";
import { field, schemaInput, section, select } from "../controls.js";
import { flatten, LABEL_FOLDERS } from "../data/lists.js";
import { el, fill } from "../dom.js";
import { mapChoice } from "./map_choice.js";
import { placingField } from "./placing.js";

/**
 * @typedef {object} JobSettings
 * @property {string} preset
 * @property {Record<string, any> | null} config Settings that differ from the preset.
 * @property {string | null} labels
 * @property {import("./map_choice.js").MapRequest} osm
 * @property {"drive"|"map"} georeference Where longitude and latitude come from.
 * @property {import("./placing.js").Near | null} near Where on the map to search.
 * @property {string} policy
 * @property {number} tolerance_m
 * @property {string} key Sent with the request, so that a repetition makes no second job.
 */

/**
 * @typedef {object} Known
 * @property {string[]} maps OSM files that the drive has, by path.
 * @property {boolean} isArchive What is in the drive is not known yet.
 * @property {string[]} folders Label folders.
 * @property {boolean} hasGeoreference
 * @property {any} presets As the service lists them.
 * @property {JobSettings | null} before What was chosen before.
 */

/** @param {Known} known @param {() => void} onChange */
export function jobForm(known, onChange) {
  const map = mapChoice(known, () => (showPolicy(), onChange()));

  const usualReach = known.before?.tolerance_m ?? 15;
  const within = { type: "number", min: 1, max: 100, step: "any", required: true };
  const tolerance = el("input", { ...within, value: usualReach, onInput: onChange });
  const toleranceField = field("Merging reach [m]", tolerance);
  const policy = policyField(known.before?.policy, () => (showPolicy(), onChange()));
  const policies = el("div.stack-s", policy.element, toleranceField);
  const placing = placingField(known.before, () => (showPolicy(), onChange()));
  function showPolicy() {
    const chosen = map.kind() ?? "none";
    policies.hidden = chosen === "none";
    placing.setMap(chosen);
    noFix.hidden = hasFix || known.isArchive || policies.hidden || placing.isOn();
    toleranceField.hidden = policy.value() !== "consolidated";
    tolerance.disabled = toleranceField.hidden || policies.hidden; // what nobody sees is not checked
  }

  const labels = el("select", { onChange });
  const labelsField = field("Labels to find intersections with", labels);
  /** @param {string[]} names */
  function setFolders(names) {
    const before = labels.value || known.before?.labels;
    const options = names.map((name) => el("option", { value: name }, LABEL_FOLDERS[name] ?? name));
    fill(labels, options);
    if (before && names.includes(before)) labels.value = before;
    labelsField.hidden = names.length < 2;
  }

  const refusal = "This drive has no GNSS: place it on the map by its roads, or the service would refuse the job.";
  const noFix = el("p.note.warning", refusal);
  let hasFix = known.hasGeoreference;
  /** @param {boolean} has */
  function setGeoreference(has) {
    hasFix = has;
    placing.suggest(!has && !known.isArchive);
    showPolicy();
  }

  const settings = settingsForm(known.presets, known.before, onChange);
  setFolders(known.folders);
  setGeoreference(known.hasGeoreference);
  const key = newKey();
  const ofMap = el("section.stack-s", map.element, placing.element, noFix, policies);

  return {
    mapElement: ofMap,
    element: section("Method", labelsField, settings.element),
    map,
    setFolders,
    setGeoreference,
    /** What has to be changed before anything is sent, in words. @returns {string | null} */
    complaint: () => (settings.isValid() && !tolerance.matches(":invalid") ? null : "A setting is out of its range."),
    /** What has to be chosen before the job can run, in words. @returns {string | null} */
    mapComplaint: () => map.complaint() ?? placing.complaint(),
    keyframes: () => ({
      distance_m: settings.value("keyframes.distance_m"),
      angle_deg: settings.value("keyframes.angle_deg"),
    }),
    /** @returns {{job: JobSettings, map: File | null}} `map`: to be sent as `osm.file`. */
    read: () => ({
      job: {
        ...settings.read(),
        labels: labels.value || null,
        osm: map.read(),
        ...placing.read(),
        policy: policy.value(),
        tolerance_m: tolerance.disabled ? usualReach : Number(tolerance.value),
        key,
      },
      map: map.ownFile(),
    }),
  };
}

/** The choice of which OSM nodes count, with an explanation below it. @param {string|undefined} chosen @param {() => void} onChange */
function policyField(chosen, onChange) {
  const { policies } = getConfig();
  const hint = el("small");
  const explain = () => fill(hint, policies.find(({ name }) => name === policy.value)?.description);
  const policy = select(Object.fromEntries(policies.map(({ name, title }) => [name, title])), chosen, () => {
    explain();
    onChange();
  });
  explain();
  const element = el("label.field", el("span", "What counts as an intersection"), policy, hint);
  return { element, value: () => policy.value };
}

/** The settings that matter most, in words; the schema has the rest. */
const MAIN = [
  ["keyframes.distance_m", "Distance between keyframes"],
  ["keyframes.window", "Keyframes in an image, before and after"],
  ["bev.size_m", "Side of the image"],
  ["bev.resolution_m", "Side of a cell"],
  ["bev.min_points", "Points that make a cell road"],
  ["branches.min_branches", "Branches of an intersection"],
];

const SECTIONS = {
  keyframes: "Keyframes",
  bev: "Image from above",
  occupancy: "Gaps and specks",
  centerline: "Centerline",
  candidates: "Candidates",
  branches: "Branches",
  compound: "Compound intersections",
  score: "Score of a detection",
  fusion: "Map of intersections",
  calibration: "Uncertainty and confidence",
};

const UNITS = { m: "m", deg: "°", px: "px", widths: "road widths" };

/**
 * @param {{presets: {name: string, description: string, config: any}[], config_schema: any}} presets As the service lists them.
 * @param {{preset: string, config: any} | null} before What was chosen before.
 * @param {() => void} onChange
 */
function settingsForm(presets, before, onChange) {
  let preset = presets.presets.find((each) => each.name === before?.preset) ?? presets.presets[0];
  /** Values that differ from the preset, by path. @type {Map<string, any>} */
  const changed = flatten(before?.config ?? {});
  const main = el("div.stack-s");
  const all = el("div.stack");
  const summary = el("small.quiet");
  const description = el("small", preset.description);
  const names = Object.fromEntries(presets.presets.map((each) => [each.name, each.name]));
  const chooser = select(names, preset.name, (name) => {
    preset = presets.presets.find((each) => each.name === name) ?? preset;
    changed.clear();
    description.textContent = preset.description;
    build();
    onChange();
  });

  /** @param {string} path @param {string} [title] */
  function control(path, title) {
    const [part, name] = path.split(".");
    const schema = schemaOf(presets.config_schema, preset.config, part)?.properties?.[name];
    const usual = preset.config[part]?.[name];
    if (!schema || usual === undefined || schema.const !== undefined) return null;
    const value = changed.has(path) ? changed.get(path) : usual;
    const take = (/** @type {any} */ next, /** @type {boolean} */ isValid) => {
      if (isValid && JSON.stringify(next) === JSON.stringify(usual)) changed.delete(path);
      else changed.set(path, next);
      describe();
      onChange();
    };
    const input = schemaInput(schema, value, take, words);
    const unit = Object.entries(UNITS).find(([suffix]) => name.endsWith(`_${suffix}`))?.[1];
    const heading = `${title ?? words(name)}${unit ? ` [${unit}]` : ""}`;
    const range = rangeOf(schema);
    const hint = el("small", schema.description, ` Preset: ${shown(usual)}${range && `; ${range}`}.`);
    return el("label.field.setting", el("span", heading), input, hint);
  }

  function build() {
    fill(main, ...MAIN.map(([path, title]) => control(path, title)));
    fill(
      all,
      Object.entries(SECTIONS).map(([part, title]) => {
        if (!preset.config[part]) return null; // a step that this preset leaves out
        const paths = Object.keys(preset.config[part]).map((name) => `${part}.${name}`);
        const controls = paths.filter((path) => !MAIN.some(([own]) => own === path)).map((path) => control(path));
        const about = schemaOf(presets.config_schema, preset.config, part)?.description;
        return section(title, about && el("small", about), controls);
      }),
    );
    describe();
  }

  function describe() {
    summary.textContent = changed.size ? `${changed.size} changed` : "as the preset has them";
  }

  build();
  const reset = el(
    "button.link",
    { type: "button", onClick: () => (changed.clear(), build(), onChange()) },
    "Back to the preset",
  );
  return {
    element: el("div.stack-s", [
      field("Preset", chooser, description),
      el("details.box", { open: changed.size > 0 }, [
        el("summary", "Settings ", summary),
        el("div.stack-s", main, el("details", el("summary", "All other settings"), all), reset),
      ]),
    ]),
    read: () => ({ preset: preset.name, config: changed.size ? nest(changed) : null }),
    /** @returns {any} The value that will be used. */
    value: (/** @type {string} */ path) =>
      changed.has(path) ? changed.get(path) : path.split(".").reduce((at, name) => at?.[name], preset.config),
    isValid: () => !all.parentElement?.parentElement?.querySelector("input:invalid"),
  };
}

/** @param {any} root @param {any} config @param {string} part The schema of a section as the configuration has it. */
function schemaOf(root, config, part) {
  const schema = root.properties[part];
  const options = [schema, ...(schema.anyOf ?? []), ...(schema.oneOf ?? [])].map((each) => resolve(root, each));
  const kind = config[part]?.kind;
  return options.find((each) => each?.properties && (kind === undefined || each.properties.kind?.const === kind));
}

/** @param {any} root @param {any} schema */
const resolve = (root, schema) => (schema.$ref ? root.$defs[schema.$ref.split("/").pop()] : schema);

/** @param {any} schema */
function rangeOf(schema) {
  const number = (schema.anyOf ?? [schema]).find((/** @type {any} */ each) => each.maximum !== undefined);
  if (!number) return "";
  const min = number.minimum ?? number.exclusiveMinimum;
  return min === undefined ? `at most ${number.maximum}` : `${min} to ${number.maximum}`;
}

/** @param {any} value */
const shown = (value) =>
  value === null ? "none" : typeof value === "boolean" ? (value ? "yes" : "no") : words(String(value));

/** @param {string} name "min_points" -> "Min points" */
function words(name) {
  const text = name.replace(/_(m|deg|px)$/, "").replaceAll("_", " ");
  return text.charAt(0).toUpperCase() + text.slice(1);
}

/** @param {Iterable<[string, any]>} values By path. @returns {Record<string, any>} By section and name. */
export function nest(values) {
  /** @type {Record<string, any>} */
  const nested = {};
  for (const [path, value] of values) {
    const [part, name] = path.split(".");
    if (name === undefined) nested[part] = value;
    else (nested[part] ??= {})[name] = value;
  }
  return nested;
}
