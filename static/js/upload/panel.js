/** The upload panel: from a folder to a job. */

import { ApiError, getJson, sendJson } from "../api.js";
import { refreshLists, rememberJob } from "../data/lists.js";
import { el, fill, plural } from "../dom.js";
import { confirmAction, problemNote, showError, showMessage } from "../shell/messages.js";
import { getState, setState } from "../state.js";
import { noDriveReason } from "./checks.js";
import { findDrives } from "./drive_folder.js";
import { folderOfHandle, folderOfInput, isArchive, measure, readDrop } from "./folder.js";
import { fingerprintOfDrive, formView } from "./form_view.js";
import { forget, handleOf, rememberedUploads } from "./memory.js";
import { progressView } from "./progress_view.js";
import { startView } from "./start_view.js";
import { Upload } from "./upload.js";

/** @typedef {import("./drive_folder.js").DriveFolder} DriveFolder */
/** @typedef {import("./memory.js").Remembered} Remembered */
/** @typedef {import("./folder.js").Folder} Folder */
/** @typedef {{driveId: string, settings: import("./upload.js").Settings}} Begun An upload to go on with. */

/** @type {Upload | null} */
let current = null;

/** @param {HTMLElement} container */
export function mount(container) {
  listenToDrops(container);
  window.addEventListener("beforeunload", (event) => {
    if (current?.isRunning) event.preventDefault(); // the browser asks whether to leave
  });
  showStart(container).catch(showError);
}

/** @param {HTMLElement} container @param {any} [message] @param {Begun | null} [begun] An upload whose folder is to be picked again. */
async function showStart(container, message = null, begun = null) {
  const uploads = await stillOpen();
  const list = await Promise.all(
    uploads.map(async (upload) => ({ upload, hasHandle: (await handleOf(upload.driveId)) !== null })),
  );
  const view = startView(
    {
      onFolder: (files) => run(container, () => showFolder(container, folderOfInput(files), begun)),
      onHandle: (handle) => run(container, () => showHandle(container, handle, begun)),
      onArchive: (file) => run(container, () => showArchive(container, file)),
      onContinue: (upload) => run(container, () => continueByHandle(container, upload)),
      onForget: (upload) => run(container, () => remove(container, upload)),
    },
    list,
    message,
  );
  fill(container, view);
}

/** Do something that may fail, and say so where it began. @param {HTMLElement} container @param {() => Promise<void>} work */
function run(container, work) {
  work().catch((error) => showStart(container, problemNote(error)).catch(showError));
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
        if (!(error instanceof ApiError && error.status === 404)) return { ...upload, arrived: null }; // cannot tell now
      }
      forget(upload.driveId);
      return null;
    }),
  );
  return /** @type {Open[]} */ (found.filter((each) => each !== null && each.driveId !== current?.driveId));
}

/** @param {HTMLElement} container @param {FileSystemDirectoryHandle} handle @param {Begun | null} [begun] */
async function showHandle(container, handle, begun = null) {
  await showFolder(container, await folderOfHandle(handle, counter(container)), begun);
}

/** @param {HTMLElement} container @returns {(count: number) => void} */
function counter(container) {
  const text = el("p", { role: "status" }, "Reading the folder …");
  fill(
    container,
    el(
      "div",
      { class: "stack" },
      el("h2", {}, "Upload a drive"),
      el("progress", { "aria-label": "Reading the folder" }),
      text,
    ),
  );
  return (count) => (text.textContent = `Reading the folder: ${plural(count, "file")} so far`);
}

/** @param {HTMLElement} container @param {Folder} folder @param {Begun | null} begun */
async function showFolder(container, folder, begun) {
  await measure(folder, counter(container));
  const drives = await findDrives(folder);
  if (!drives.length) {
    const error = { title: "No drive in there", detail: noDriveReason(folder) };
    await showStart(container, problemNote(error), begun);
    return;
  }
  const known = rememberedUploads();
  const match = drives.find((drive) => known.some((upload) => upload.fingerprint === fingerprintOfDrive(drive)));
  await showForm(container, { drive: match ?? drives[0], drives, archive: null, handle: folder.handle }, begun);
}

/** @param {HTMLElement} container @param {File} file */
async function showArchive(container, file) {
  if (!isArchive(file)) {
    const detail = `${file.name} is none of .zip, .tar, .tar.gz, .tar.zst.`;
    await showStart(container, problemNote({ title: "No archive", detail }));
    return;
  }
  await showForm(container, { drive: null, drives: [], archive: file, handle: null }, null);
}

/**
 * @param {HTMLElement} container
 * @param {{drive: DriveFolder | null, drives: DriveFolder[], archive: File | null, handle: FileSystemDirectoryHandle | null}} picked
 * @param {Begun | null} begun The upload that this is to go on with.
 */
async function showForm(container, picked, begun) {
  const presets = await getJson("presets");
  const fingerprint = picked.drive && fingerprintOfDrive(picked.drive);
  const match =
    begun || !fingerprint ? null : ((await stillOpen()).find((upload) => upload.fingerprint === fingerprint) ?? null);
  const view = formView(
    { ...picked, presets, begun: match, before: begun?.settings ?? null },
    {
      onStart: (source, settings) =>
        start(container, picked, new Upload(source, settings, () => {}, begun?.driveId ?? null)),
      onBack: () => run(container, () => showStart(container)),
      onChoose: (drive) => run(container, () => showForm(container, { ...picked, drive }, null)),
      onContinue: (upload) => run(container, () => goOn(container, picked, upload)),
    },
  );
  fill(container, view);
}

/** @param {HTMLElement} container @param {Remembered} upload */
async function continueByHandle(container, upload) {
  const handle = await handleOf(upload.driveId);
  if (!handle || (await handle.requestPermission({ mode: "read" })) !== "granted") {
    const detail = `Pick the folder of ${upload.name} again to go on.`;
    await showStart(container, problemNote({ title: "The browser does not open the folder by itself", detail }));
    return;
  }
  const folder = await folderOfHandle(handle, counter(container));
  const drives = await findDrives(folder);
  const drive = drives.find((each) => each.root === upload.root);
  if (!drive) throw new Error(`${folder.name} no longer holds ${upload.root || upload.name}. Pick its folder again.`);
  await goOn(container, { drive, drives, archive: null, handle }, upload);
}

/**
 * Go on with an upload at once, or ask for the files that only the form can give.
 *
 * @param {HTMLElement} container
 * @param {{drive: DriveFolder | null, drives: DriveFolder[], archive: File | null, handle: FileSystemDirectoryHandle | null}} picked
 * @param {Remembered} upload
 */
async function goOn(container, picked, { driveId, settings }) {
  const drive = /** @type {DriveFolder} */ (picked.drive);
  const osm = settings.job?.osm;
  const extras = new Map();
  for (const path of [osm && "file" in osm ? osm.file : null, settings.options.oxts]) {
    if (!path) continue;
    const own = drive.maps.get(path) ?? drive.small.get(path);
    const isThere = own || (await isOnService(driveId, path));
    if (own) extras.set(path, own);
    if (!isThere) {
      await showForm(container, picked, { driveId, settings });
      showMessage(`${path.split("/").pop()} had not arrived yet: pick it again.`);
      return;
    }
  }
  const { handle } = picked;
  const source = { drive, archive: null, extras, handle, fingerprint: fingerprintOfDrive(drive) };
  await start(container, picked, new Upload(source, settings, () => {}, driveId));
}

/** @param {string} driveId @param {string} path */
async function isOnService(driveId, path) {
  const folder = await getJson(`drives/${driveId}/files?limit=1&after=${encodeURIComponent(path.slice(0, -1))}`);
  return folder.files[0]?.path === path;
}

/** @param {HTMLElement} container @param {any} picked @param {Upload} upload */
async function start(container, picked, upload) {
  current = upload;
  const begun = () => (upload.driveId ? { driveId: upload.driveId, settings: upload.settings } : null);
  const view = progressView({
    onChange: () => run(container, () => showForm(container, picked, begun())),
    onMend: () =>
      run(container, () =>
        showStart(
          container,
          el("p", { class: "note" }, "Pick the folder again. What did not change is not sent again."),
          begun(),
        ),
      ),
    onLeave: () => run(container, () => showStart(container)),
  });
  fill(container, view.element);
  upload.onChange = () => view.update(upload);
  upload.transfer.onChange = upload.onChange;
  await upload.run();
  view.update(upload);
  if (upload.driveId) await refreshLists().catch(() => {}); // the lists show it later, then
  if (upload.status !== "done" || current !== upload) return;
  current = null;
  if (upload.jobId) {
    rememberJob(await getJson(`jobs/${upload.jobId}`));
    setState({
      drive: upload.driveId,
      job: upload.jobId,
      frame: null,
      view: null,
      ...(getState().panel === "upload" ? { panel: "job" } : {}),
    });
    await showStart(container);
  } else {
    setState({ drive: upload.driveId });
  }
}

/** @param {HTMLElement} container @param {Remembered} upload */
async function remove(container, upload) {
  const text = "What has arrived on the service is removed. The files on this machine stay.";
  if (!(await confirmAction(`Remove the upload of ${upload.name}?`, text, "Remove"))) return;
  await sendJson("DELETE", `drives/${upload.driveId}`).catch((error) => {
    if (!(error instanceof ApiError && error.status === 404)) throw error;
  });
  forget(upload.driveId);
  await showStart(container);
  await refreshLists();
}

/** Take what is dropped anywhere on the page. @param {HTMLElement} container */
function listenToDrops(container) {
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
  window.addEventListener("dragover", (event) => isFiles(event) && event.preventDefault());
  window.addEventListener("drop", (event) => {
    if (!isFiles(event) || !event.dataTransfer) return;
    event.preventDefault();
    depth = 0;
    mark();
    if (current?.isRunning) {
      showMessage("An upload is under way: stop it first, or wait for its end.");
      return;
    }
    setState({ panel: "upload" });
    const dropped = readDrop(event.dataTransfer, counter(container));
    run(container, async () => {
      const found = await dropped;
      if ("archive" in found) await showArchive(container, found.archive);
      else await showFolder(container, found.folder, null);
    });
  });
}
