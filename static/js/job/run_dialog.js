/**
 * Run a drive that is there already: preset, map, policy.
 * @module job/run_dialog
 */
import { getConfig, getJson, isMap, sendJson } from "../api.js";
import { field, openDialog, select } from "../controls.js";
import { lists, loadPresets, rememberJob } from "../data/lists.js";
import { el, fill } from "../dom.js";
import { problemNote } from "../messages.js";
import { placingField } from "./placing.js";
import { openJob } from "./words.js";

/**
 * The choice of which OSM nodes count, with an explanation below it.
 * @param {string} [chosen]
 * @param {(policy: string) => void} [onChange]
 */
export function policyField(chosen, onChange) {
  const { policies } = getConfig();
  const hint = el("small", {});
  const explain = () => fill(hint, policies.find(({ name }) => name === policy.value)?.description);
  const policy = select(Object.fromEntries(policies.map(({ name, title }) => [name, title])), chosen, (value) => {
    explain();
    onChange?.(value);
  });
  explain();
  const element = el("label", { class: "field" }, el("span", {}, "What counts as an intersection"), policy, hint);
  return { element, value: () => policy.value };
}

/** @param {string} id Of the drive. */
export async function openRunDialog(id) {
  const [drive, { files }] = await Promise.all([
    getJson(`drives/${id}`), // with its report, which lists leave out
    getJson(`drives/${id}/files?limit=10000`),
    loadPresets(),
  ]);
  const maps = files.map((/** @type {any} */ file) => file.path).filter(isMap);
  const preset = select(
    Object.fromEntries(lists.presets.map(({ name, description }) => [name, `${name} – ${description}`])),
  );
  const map = select({
    ...Object.fromEntries(maps.map((/** @type {string} */ path) => [`file:${path}`, path])),
    ...(getConfig().overpass ? { overpass: "From OpenStreetMap now (Overpass)" } : {}),
    "": "None – only detect",
  });
  const policy = policyField();
  const placing = placingField(null, () => {});
  const chooseMap = () => placing.setMap(map.value === "overpass" ? "overpass" : map.value ? "file" : "none");
  map.addEventListener("change", chooseMap);
  placing.suggest(!drive.report?.georeference);
  chooseMap();
  const trouble = el("div", {});
  const run = el("button", { class: "primary", value: "run" }, "Run");
  const form = el(
    "form",
    { method: "dialog", class: "stack", onSubmit: (/** @type {Event} */ e) => (e.preventDefault(), void submit()) },
    el("h2", {}, `Run ${drive.name}`),
    field("Preset", preset),
    field("Map to score against", map),
    placing.element,
    policy.element,
    trouble,
    el("div", { class: "actions" }, el("button", { type: "button", onClick: () => dialog.close() }, "Cancel"), run),
  );
  const dialog = openDialog({}, [form]);

  const submit = async () => {
    const complaint = placing.complaint();
    if (complaint) return fill(trouble, el("p", { class: "note warning" }, complaint));
    run.disabled = true;
    const osm = map.value === "overpass" ? { overpass: true } : map.value ? { file: map.value.slice(5) } : undefined;
    try {
      const body = { drive_id: drive.id, preset: preset.value, policy: policy.value(), osm, ...placing.read() };
      const job = await sendJson("POST", "jobs", body);
      rememberJob(job);
      dialog.close();
      openJob(job);
    } catch (error) {
      fill(trouble, problemNote(error));
      run.disabled = false;
    }
  };
}
