/** Run a drive that is there already: afresh, or once more as an earlier job, with what is to be different. */
import { encodePath, getJson, putFile, sendJson } from "../api.js";
import { field } from "../controls.js";
import { rememberJob, titleOf } from "../data/lists.js";
import { el, fill } from "../dom.js";
import { attempt, openDialog } from "../messages.js";
import { jobForm, nest } from "./job_form.js";
import { openJob } from "./words.js";

/**
 * @param {string} id Of the drive.
 * @param {object} [start]
 * @param {any} [start.job] The job to start from.
 * @param {boolean} [start.withMap] It had no map, and is to get one.
 */
export async function openRunDialog(id, { job, withMap = false } = {}) {
  const [drive, presets] = await Promise.all([getJson(`drives/${id}`), getJson("presets")]);
  const hasGeoreference = Boolean(drive.report?.georeference);
  const before = job ? settingsOf(job) : null;
  if (before && withMap) {
    before.osm ??= { file: "" }; // one that the drive does not have: to be chosen
    if (!hasGeoreference) before.georeference = "map";
  }
  const [maps, folders] = [drive.maps ?? [], drive.label_folders ?? []];
  const form = jobForm({ maps, isArchive: false, folders, hasGeoreference, presets, before }, refresh);
  const name = el("input", { type: "text", maxLength: 200, placeholder: "made from what is chosen below" });
  const why = el("small", { role: "status" });
  const trouble = el("div", { role: "status" });
  const run = el("button.primary", { value: "run", formNoValidate: true }, "Run");
  const stop = new AbortController();
  const content = [
    job && el("p.small", `All is chosen as it was for the job “${titleOf(job)}”.`),
    field("Name of the job", name),
    form.mapElement,
    form.element,
  ];
  const dialog = openDialog(job ? `Run ${drive.name} again` : `Run ${drive.name}`, content, {
    actions: [why, el("button", { type: "button", onClick: () => dialog.close() }, "Cancel"), run],
    trouble,
    kind: "wide",
    onSubmit: () => submit(),
    onClose: () => stop.abort(),
  });

  function refresh() {
    const complaint = form.complaint() ?? form.mapComplaint();
    run.disabled = complaint !== null;
    why.textContent = complaint ?? "";
  }

  /** The map that was sent, so that it is not sent again where the job is refused. @type {{file: File, path: string}|null} */
  let sent = null;
  /** @param {File} file @returns {Promise<{file: string}>} As the job is asked for it. */
  const send = async (file) => {
    if (sent?.file !== file) {
      const path = freeName(file.name, maps);
      const onProgress = (/** @type {number} */ bytes) =>
        fill(trouble, el("p.small", `Sending the map: ${Math.floor((100 * bytes) / file.size)} %`));
      await putFile(`drives/${drive.id}/files/${encodePath(path)}`, file, { onProgress, signal: stop.signal });
      sent = { file, path };
    }
    return { file: sent.path };
  };

  const submit = async () => {
    run.disabled = true;
    const isDone = await attempt(trouble, async () => {
      const { job: chosen, map } = form.read();
      const { key, ...settings } = chosen;
      const osm = map ? await send(map) : settings.osm;
      const body = { drive_id: drive.id, name: name.value.trim() || null, ...settings, osm };
      const made = await sendJson("POST", "jobs", body, { headers: { "Idempotency-Key": key } });
      dialog.close(); // what opened it is still there, to get the focus
      rememberJob(made);
      openJob(made);
    });
    run.disabled = isDone;
  };
  refresh();
}

/** @param {any} job @returns {import("./job_form.js").JobSettings} What it was asked for. */
function settingsOf({ request, own_settings }) {
  return {
    preset: request.preset ?? "default",
    config: nest(Object.entries(own_settings)),
    labels: request.labels ?? null,
    osm: request.osm ?? null,
    georeference: request.georeference ?? "drive",
    near: request.near ?? null,
    policy: request.policy,
    tolerance_m: request.tolerance_m,
    key: "",
  };
}

/** @param {string} name @param {string[]} taken @returns {string} "map-2.osm.gz" where the drive has a map.osm.gz. */
export function freeName(name, taken) {
  const dot = name.indexOf(".", 1);
  const [stem, ending] = dot < 0 ? [name, ""] : [name.slice(0, dot), name.slice(dot)];
  let free = name;
  for (let i = 2; taken.some((each) => each.toLowerCase() === free.toLowerCase()); i += 1)
    free = `${stem}-${i}${ending}`;
  return free;
}
