/** The upload panel: from picking a folder, or going on with an upload that was begun, to a job. */

import { ApiError, getConfig, getJson, isArchive, sendJson } from "../api.js";
import { filePicker, iconButton, section } from "../controls.js";
import { refreshLists, rememberJob } from "../data/lists.js";
import { tellUpload } from "../data/uploads.js";
import { el, fill, formatAgo, formatBytes, icon, plural, takesDrops } from "../dom.js";
import { afterDeletion } from "../job/words.js";
import { confirmAction, problemNote, showError, showMessage } from "../messages.js";
import { getState, setState } from "../state.js";
import { lookInto } from "./drive_folder.js";
import { folderOfInput, measure, readDrop } from "./folder.js";
import { fingerprintOfDrive, formView } from "./form.js";
import { forget, rememberedUploads } from "./memory.js";
import { dropPreview, setPreviewProgress, showPreview } from "./preview.js";
import { progressView } from "./progress_view.js";
import { Upload } from "./upload.js";

/** @import { DriveFolder } from "./drive_folder.js" */
/** @import { Folder } from "./folder.js" */
/** @import { Remembered } from "./memory.js" */
/**
 * @typedef {object} Picked
 * @property {DriveFolder | null} drive
 * @property {import("./drive_folder.js").ListedName[]} drives All in the folder.
 * @property {File | null} archive
 */
/** @typedef {{driveId: string, settings: import("./upload.js").Settings}} Begun An upload to go on with. */

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
  dropPreview();
  const uploads = await stillOpen();
  const onChange = () => input.files.length && run(() => showFolder(folderOfInput(input.files), begun));
  const input = el("input", { type: "file", name: "folder", webkitdirectory: true, hidden: true, onChange });
  const { archives, recordings, scans, beside, maps } = getConfig().file_kinds;
  const takeFiles = (/** @type {FileList} */ list) =>
    run(() => (isArchive(list[0].name) ? showArchive(list[0], begun) : showFolder(folderOfInput(list), begun)));
  const pickFiles = filePicker("Choose files", takeFiles, {
    accept: [...archives, ...recordings, ...scans, ...beside, ...maps].map(lastEnding).join(","),
    multiple: true,
    name: "files",
  });
  const open = uploads.map((upload) => {
    const { name, at, arrived } = upload;
    const has = arrived && ` · ${plural(arrived.files, "file")} there, ${formatBytes(arrived.size_bytes)}`;
    const title = el("strong.cut", name);
    const about = el("div.cut", title, el("br"), el("small", formatAgo(at), has));
    return el("div.box.spread", [
      about,
      iconButton("trash", `Remove ${name}`, () => run(() => remove(upload)), "Remove it from the service"),
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
      open.length > 0 && section("Uploads that were begun", el("p.small", AGAIN), open),
      el("details", el("summary", "What a drive looks like"), el("pre.code.box", { tabIndex: 0 }, EXAMPLE)),
    ]),
  );
}

/** Do something that may fail, and show it where it began. @param {() => Promise<void>} work */
function run(work) {
  work().catch((error) => showStart(problemNote(error)).catch(showError));
}

/** @typedef {Remembered & {arrived: {files: number, size_bytes: number} | null}} Open With what the service has of it. */

/** @returns {Promise<Open[]>} Uploads that were begun and can go on. */
async function stillOpen() {
  const found = await Promise.all(
    rememberedUploads().map(async (upload) => {
      try {
        const drive = await getJson(`drives/${upload.driveId}`);
        if (drive.state !== "ready") return { ...upload, arrived: drive };
      } catch (error) {
        if (!(error instanceof ApiError && error.status === 404)) return { ...upload, arrived: null }; // unknown now
      }
      forget(upload.driveId);
      return null;
    }),
  );
  return /** @type {Open[]} */ (found.filter((each) => each !== null && each.driveId !== current?.driveId));
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
  await measure(folder, counter());
  const { drives, drive, reason } = await lookInto(folder);
  if (!drive) {
    const error = { title: "No drive in this folder", detail: /** @type {string} */ (reason) };
    await showStart(problemNote(error), begun);
    return;
  }
  await showForm({ drive, drives, archive: null }, begun);
}

/** @param {File} file @param {Begun | null} begun */
async function showArchive(file, begun) {
  await showForm({ drive: null, drives: [], archive: file }, begun);
}

/** @param {Picked} picked @param {Begun | null} begun The upload that this is to go on with. */
async function showForm(picked, begun) {
  const isUnlabelled =
    !picked.drive || (picked.drive.look.layout !== "reduced" && !Object.keys(picked.drive.look.labels).length);
  const networks = isUnlabelled ? getJson("models") : { models: [] };
  const [presets, { models }] = await Promise.all([getJson("presets"), networks]);
  const fingerprint = picked.drive && fingerprintOfDrive(picked.drive);
  const match =
    begun || !fingerprint ? null : ((await stillOpen()).find((upload) => upload.fingerprint === fingerprint) ?? null);
  const view = formView(
    { ...picked, presets, networks: models, begun: match, before: begun?.settings ?? null },
    {
      onStart: (source, settings) => start(picked, new Upload(source, settings, () => {}, begun?.driveId ?? null)),
      onBack: () => run(() => showStart()),
      onChoose: (root) => run(() => chooseDrive(picked, root)),
      onContinue: (upload) => run(() => goOn(picked, upload)),
    },
  );
  if (!picked.drive) dropPreview();
  fill(panel, view);
}

/** @param {Picked} picked @param {string} root */
async function chooseDrive(picked, root) {
  const { folder } = /** @type {DriveFolder} */ (picked.drive);
  await showForm({ ...picked, drive: (await lookInto(folder, { root })).drive }, null);
}

/**
 * Go on with an upload at once, or ask for the files that only the form can give.
 *
 * @param {Picked} picked
 * @param {Remembered} upload
 */
async function goOn(picked, { driveId, settings }) {
  const drive = /** @type {DriveFolder} */ (picked.drive);
  const osm = settings.job?.osm;
  const extras = new Map();
  for (const path of [osm && "file" in osm ? osm.file : null, settings.options.oxts]) {
    if (!path) continue;
    const own = drive.maps.get(path) ?? drive.small.get(path);
    if (own) extras.set(path, own);
    else {
      await showForm(picked, { driveId, settings });
      showMessage(`Pick ${path.split("/").pop()} again: it is not in the folder of the drive.`);
      return;
    }
  }
  const source = { drive, archive: null, extras, fingerprint: fingerprintOfDrive(drive) };
  await start(picked, new Upload(source, settings, () => {}, driveId));
}

/** @param {Picked} picked @param {Upload} upload */
async function start(picked, upload) {
  current = upload;
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
  upload.transfer.onChange = upload.onChange;
  await upload.run();
  view.update(upload);
  if (upload.driveId) await refreshLists().catch(() => {}); // the lists show it later, then
  if (upload.status !== "done" || current !== upload) return;
  current = null;
  if (upload.jobId) {
    rememberJob(await getJson(`jobs/${upload.jobId}`));
    const next = getState().panel === "upload" ? { panel: "result" } : {};
    setState({ drive: upload.driveId, job: upload.jobId, frame: null, view: null, ...next });
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

/** @param {Remembered} upload */
async function remove(upload) {
  const text = `What has arrived on the service is removed; the files on this machine stay. ${afterDeletion()}`;
  if (!(await confirmAction(`Remove the upload of ${upload.name}?`, text, "Remove"))) return;
  await sendJson("DELETE", `drives/${upload.driveId}`).catch((error) => {
    if (!(error instanceof ApiError && error.status === 404)) throw error;
  });
  forget(upload.driveId);
  await showStart();
  await refreshLists();
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
