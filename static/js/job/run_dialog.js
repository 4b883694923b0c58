/**
 * Run a drive that is there already: preset, map, policy.
 * @module job/run_dialog
 */
import { getJson, sendJson } from "../api.js";
import { rememberJob } from "../data/lists.js";
import { el, fill } from "../dom.js";
import { getConfig } from "../shell/config.js";
import { problemNote } from "../shell/messages.js";
import { setState } from "../state.js";

const POLICIES = [
  ["drive", "Drivable roads", "Nodes at which three or more drivable roads meet. The usual choice."],
  ["drive+service", "Drivable and service roads", "Driveways and car parks too."],
  ["all", "All ways", "Footpaths and cycleways too."],
  ["consolidated", "Drivable, merged", "Nodes of one junction merged into one."],
];

/** @param {any} drive */
export async function openRunDialog(drive) {
  const { files } = await getJson(`drives/${drive.id}/files?limit=10000`);
  const maps = files
    .map((/** @type {any} */ f) => f.path)
    .filter((/** @type {string} */ path) => /\.osm(\.(gz|bz2|pbf))?$/.test(path));
  const preset = el(
    "select",
    {},
    el("option", { value: "default" }, "default – the best we know"),
    el("option", { value: "paper" }, "paper – literally as published"),
  );
  const map = el(
    "select",
    {},
    maps.map((/** @type {string} */ path) => el("option", { value: `file:${path}` }, path)),
    getConfig().overpass && el("option", { value: "overpass" }, "From OpenStreetMap now (Overpass)"),
    el("option", { value: "" }, "None – only detect"),
  );
  const policy = el(
    "select",
    {},
    POLICIES.map(([id, title]) => el("option", { value: id }, title)),
  );
  const hint = el("small", {});
  const explain = () => fill(hint, POLICIES.find(([id]) => id === policy.value)?.[2]);
  policy.addEventListener("change", explain);
  explain();
  const trouble = el("div", {});
  const run = el("button", { class: "primary", value: "run" }, "Run");
  const dialog = el(
    "dialog",
    { onClose: () => dialog.remove() },
    el(
      "form",
      {
        method: "dialog",
        class: "stack",
        onSubmit: (/** @type {Event} */ event) => (event.preventDefault(), void submit()),
      },
      el("h2", {}, `Run ${drive.name}`),
      el("label", { class: "field" }, el("span", {}, "Preset"), preset),
      el("label", { class: "field" }, el("span", {}, "Map to score against"), map),
      el("label", { class: "field" }, el("span", {}, "What counts as an intersection"), policy, hint),
      trouble,
      el("div", { class: "actions" }, el("button", { type: "button", onClick: () => dialog.close() }, "Cancel"), run),
    ),
  );
  document.body.append(dialog);
  dialog.showModal();

  const submit = async () => {
    run.disabled = true;
    /** @type {any} */
    const body = { drive_id: drive.id, preset: preset.value, policy: policy.value };
    if (map.value === "overpass") body.osm = { overpass: true };
    else if (map.value) body.osm = { file: map.value.slice(5) };
    try {
      const job = await sendJson("POST", "jobs", body);
      rememberJob(job);
      dialog.close();
      setState({ drive: drive.id, job: job.id, panel: "job", frame: null, view: null });
    } catch (error) {
      fill(trouble, problemNote(error));
      run.disabled = false;
    }
  };
}
