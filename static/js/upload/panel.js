/** The upload panel: from picking a folder, or going on with an upload that was begun, to a job. */

import { getConfig, getJson, isArchive, sendJson } from "../api.js";
import { filePicker, iconButton, section } from "../controls.js";
import { demo } from "../data/demo.js";
import { lists, refreshLists, rememberJob } from "../data/lists.js";
import { tellUpload } from "../data/uploads.js";
import { el, fill, formatAgo, formatBytes, icon, plural, takesDrops } from "../dom.js";
import { afterDeletion, openJob } from "../job/words.js";
import { confirmAction, problemNote, showError, showMessage } from "../messages.js";
import { getState, setState } from "../state.js";
import { lookInto } from "./drive_folder.js";
import { folderOfInput, measure, readDrop } from "./folder.js";
import { formView } from "./form.js";
import { dropPreview, setPreviewProgress, showPreview } from "./preview.js";
import { progressView } from "./progress_view.js";
import { Upload } from "./upload.js";

/** @import { DriveFolder } from "./drive_folder.js" */
/** @import { Folder } from "./folder.js" */
/**
 * @typedef {object} Picked
 * @property {DriveFolder | null} drive
 * @property {import("./drive_folder.js").ListedName[]} drives All in the folder.
 * @property {File | null} archive
 */
/** @typedef {{driveId: string, settings: Partial<import("./upload.js").Settings>}} Begun An upload to go on with. */

const EXAMPLE = `07/
  velodyne/000000.bin, 000001.bin, …
  labels/000000.label, …     or predictions/
  poses.txt   calib.txt   times.txt
  oxts/data/… or geo.csv     optional
  map.osm.gz                 optional

Others: KITTI raw, KITTI-360, and as recorded
  pcd/000000.pcd, …   poses.txt
  drive.mcap or drive.bag
  drive.db3           metadata.yaml
  street.laz, …       trajectory.csv`;
const AGAIN = "Pick the same again to go on. What did not change is not sent again.";
/** What a list of endings to pick from can hold of `.tar.gz`. @param {string} ending */
const lastEnding = (ending) => ending.slice(ending.lastIndexOf("."));

/** @type {Upload | null} */
let current = null;

/** Counts what was asked to be shown: what answers later than something newer is not. */
let turn = 0;

/** @type {HTMLElement} Of this panel; there is one. */
let panel;

/** @param {HTMLElement} container */
export function mount(container) {
  panel = container;
  listenToDrops();
  window.addEventListener("beforeunload", (event) => {
    if (current?.isRunning) event.preventDefault(); // the browser asks whether to leave
  });
  showStart().catch(showError);
}

/**
 * Show what can be picked or dropped, and the uploads that were begun.
 *
 * @param {any} [message] What happened to the last try.
 * @param {Begun | null} [begun] An upload whose folder is to be picked again.
 */
async function showStart(message = null, begun = null) {
  const mine = ++turn;
  dropPreview();
  if (!lists.isLoaded) await refreshLists().catch(showError);
  if (mine !== turn) return;
  const onChange = () => input.files.length && run(() => showFolder(folderOfInput(input.files), begun));
  const input = el("input", { type: "file", name: "folder", webkitdirectory: true, hidden: true, onChange });
  const { archives, recordings, scans, beside, maps } = getConfig().file_kinds;
  const takeFiles = (/** @type {FileList} */ list) =>
    run(() => {
      const isOne = list.length === 1 && isArchive(list[0].name);
      return isOne ? showArchive(list[0], begun) : showFolder(folderOfInput(list), begun);
    });
  const pickFiles = filePicker("Choose files", takeFiles, {
    accept: [...archives, ...recordings, ...scans, ...beside, ...maps].map(lastEnding).join(","),
    multiple: true,
    name: "files",
  });
  const uploads = lists.drives.filter(({ id, state }) => state === "uploading" && id !== demo.drive);
  const open = uploads.map((drive) => {
    const { id, name, created_at, files, size_bytes, options, keep_raw: keepRaw } = drive;
    const has = files > 0 && ` · ${plural(files, "file")} there, ${formatBytes(size_bytes)}`;
    const about = el("div.cut.grow", el("strong", name), el("br"), el("small", formatAgo(created_at), has));
    const goOn = () => run(() => showStart(el("p.note", AGAIN), { driveId: id, settings: { name, options, keepRaw } }));
    return el("div.box.spread", [
      about,
      el("button", { onClick: goOn, "aria-label": `Go on with ${name}` }, "Go on"),
      iconButton("trash", `Remove ${name}`, () => run(() => remove(drive)), "Remove it from the service"),
    ]);
  });
  const call = el("strong", takesDrops() ? "Drop the folder of a drive here" : "Choose the folder of a drive");
  const kinds = `or files: ${recordings.join(", ")}; archives: .zip, .tar, .tar.gz, .tar.zst`;
  const or = el("span.quiet", kinds);
  const buttons = [el("button.primary", { onClick: () => input.click() }, "Choose a folder"), pickFiles];
  const note =
    "No file is sent before you press a button. Scans are reduced to their ground points in the browser, so that a " +
    "drive of 11 GB becomes some hundred MB. Bags, LAS and PCD files are sent as they are.";
  fill(
    panel,
    el("div.stack", [
      el("h2", "Upload a drive"),
      message,
      el("div.drop.stack", icon("upload"), el("p", call, el("br"), or), el("div.row", buttons), input),
      el("p.small", note),
      !begun && open.length > 0 && section("Uploads that were begun", open),
      el("details", el("summary", "What a drive looks like"), el("pre.code.box", { tabIndex: 0 }, EXAMPLE)),
    ]),
  );
}

/** Do something that may fail, and show it where it began. @param {() => Promise<void>} work */
function run(work) {
  work().catch((error) => showStart(problemNote(error)).catch(showError));
}

/** @returns {(count: number) => void} */
function counter() {
  const text = el("p", { role: "status" }, "Reading the folder …");
  const bar = el("progress", { "aria-label": "Reading the folder" });
  fill(panel, el("div.stack", el("h2", "Upload a drive"), bar, text));
  return (count) => (text.textContent = `Reading the folder: ${plural(count, "file")} so far`);
}

/** @param {Folder} folder @param {Begun | null} begun */
async function showFolder(folder, begun) {
  const mine = ++turn;
  await measure(folder, counter());
  const { drives, drive, reason } = await lookInto(folder);
  if (mine !== turn) return;
  if (!drive) {
    const error = { title: "No drive in this folder", detail: /** @type {string} */ (reason) };
    await showStart(problemNote(error), begun);
    return;
  }
  await showForm({ drive, drives, archive: null }, begun);
}

/** @param {File} archive @param {Begun | null} begun */
const showArchive = (archive, begun) => showForm({ drive: null, drives: [], archive }, begun);

/** @param {Picked} picked @param {Begun | null} begun The upload that this is to go on with. */
async function showForm(picked, begun) {
  const mine = ++turn;
  const isUnlabelled =
    !picked.drive || (picked.drive.look.layout !== "reduced" && !Object.keys(picked.drive.look.labels).length);
  const networks = isUnlabelled ? getJson("models") : { models: [] };
  const [presets, { models }] = await Promise.all([getJson("presets"), networks]);
  if (mine !== turn) return;
  const view = formView(
    { ...picked, presets, networks: models, before: begun?.settings ?? null },
    {
      onStart: (source, settings) => start(picked, new Upload(source, settings, begun?.driveId ?? null)),
      onBack: () => run(() => showStart()),
      onChoose: (root) => run(() => chooseDrive(picked, root)),
    },
  );
  if (!picked.drive) dropPreview();
  fill(panel, view);
}

/** @param {Picked} picked @param {string} root */
async function chooseDrive(picked, root) {
  const mine = ++turn;
  const { folder } = /** @type {DriveFolder} */ (picked.drive);
  const { drive } = await lookInto(folder, { root });
  if (mine === turn) await showForm({ ...picked, drive }, null);
}

/** @param {Picked} picked @param {Upload} upload */
async function start(picked, upload) {
  current = upload;
  turn += 1;
  const begun = () => (upload.driveId ? { driveId: upload.driveId, settings: upload.settings } : null);
  const view = progressView({
    onChange: () => run(() => showForm(picked, begun())),
    onCorrect: () => run(() => showStart(el("p.note", AGAIN), begun())),
    onLeave: () => run(() => showStart()),
  });
  fill(panel, view.element);
  if (picked.drive) previewOf(picked.drive, upload);
  upload.onChange = () => {
    view.update(upload);
    const { driveId, sent, isRunning } = upload;
    if (sent !== null) setPreviewProgress(sent);
    tellUpload(isRunning && driveId ? { driveId, fraction: sent } : null);
  };
  await upload.run();
  view.update(upload);
  if (upload.driveId) await refreshLists().catch(() => {}); // the lists show it later, then
  if (upload.status !== "done" || current !== upload) return;
  current = null;
  if (upload.jobId) {
    const job = rememberJob(await getJson(`jobs/${upload.jobId}`));
    if (getState().panel === "upload") openJob(job);
    await showStart();
  } else {
    setState({ drive: upload.driveId });
  }
}

/** Draw what is being sent. @param {DriveFolder} drive @param {Upload} upload */
function previewOf(drive, { source, settings }) {
  const { job } = settings;
  const path = job?.osm && "file" in job.osm ? job.osm.file : "";
  const map = source.extras.get(path) ?? drive.maps.get(path) ?? null;
  showPreview(drive, map, () => {});
}

/** @param {any} drive */
async function remove({ id, name }) {
  const text = `What has arrived on the service is removed; the files on this machine stay. ${afterDeletion()}`;
  if (!(await confirmAction(`Remove the upload of ${name}?`, text, "Remove"))) return;
  await sendJson("DELETE", `drives/${id}`);
  await refreshLists();
  await showStart();
}

/** Take what is dropped anywhere on the page. */
function listenToDrops() {
  const isFiles = (/** @type {DragEvent} */ event) => [...(event.dataTransfer?.types ?? [])].includes("Files");
  let depth = 0;
  const mark = () => document.body.classList.toggle("dropping", depth > 0);
  window.addEventListener("dragenter", (event) => {
    if (isFiles(event)) depth += 1;
    mark();
  });
  window.addEventListener("dragleave", (event) => {
    if (isFiles(event)) depth = Math.max(0, depth - 1);
    mark();
  });
  window.addEventListener("drop", (event) => {
    if (!isFiles(event) || !event.dataTransfer) return;
    depth = 0;
    mark();
    if (current?.isRunning) {
      showMessage("An upload is under way: stop it first, or wait until it is done.");
      return;
    }
    setState({ panel: "upload" });
    const dropped = readDrop(event.dataTransfer, counter());
    run(async () => {
      const found = await dropped;
      if ("archive" in found) await showArchive(found.archive, null);
      else await showFolder(found.folder, null);
    });
  });
}
