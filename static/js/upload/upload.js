/** One upload from the first file to the job: every step can be repeated, so it goes on where it stopped. */

import { ApiError, isMap, sleep } from "../api.js";
import { bytesOf, lookInto, numbersOf, plannedFiles, rawFiles, sorted } from "./drive_folder.js";
import { forget, remember, remembered } from "./memory.js";
import { listPresent, manifestBytes, sendFiles, sendReduced, sendSmallFiles } from "./sending.js";
import { Transfer } from "./transfer.js";

/** @import { FileProblem } from "../api.js" */
/** @import { JobSettings } from "../job/job_form.js" */
/** @import { DriveFolder } from "./drive_folder.js" */
/** @import { Present } from "./sending.js" */
/**
 * @typedef {object} Settings
 * @property {string} name
 * @property {string[]} folders Label folders that are sent.
 * @property {"keyframes" | "scans" | "raw"} sending Ground points of keyframes, of every scan, or everything as it is.
 * @property {boolean} keepRaw
 * @property {ReadingOptions} options
 * @property {{distance_m: number, angle_deg: number}} keyframes
 * @property {JobSettings | null} job null: only upload.
 */

/** @typedef {Record<string, any>} ReadingOptions How the service reads the files: `DriveOptionsModel` of the API. */

/**
 * @typedef {object} Source What was picked.
 * @property {DriveFolder | null} drive
 * @property {File | null} archive
 * @property {Map<string, File>} extras Files from elsewhere, by their paths in the drive: a map, a georeference.
 * @property {string} fingerprint
 */

/** @param {ReadingOptions} options @returns {"geometry" | "predictions" | null} Labels that the service makes. */
export const madeFolder = ({ labels, model }) => labels ?? (model ? "predictions" : null);

/** @typedef {"files" | "plan" | "scans" | "archive" | "check" | "run"} Step */
/** @typedef {"ready" | "running" | "paused" | "failed" | "stopped" | "done"} Status */

const COMMIT_WAIT_S = 3;
const POLL_MS = 700;
/** What the service does in the stages of a commit. */
const STAGES = /** @type {Record<string, string>} */ ({
  waiting: "Waiting for the service to begin",
  labelling: "Labelling the scans",
  reducing: "Reducing the scans",
  storing: "Storing the drive",
});
const GROUND_POINT_BYTES = 7; // packed without loss, scans of 64 beams

export class Upload {
  /**
   * @param {Source} source
   * @param {Settings} settings
   * @param {() => void} onChange
   * @param {string | null} [driveId] Of an upload that was begun before.
   */
  constructor(source, settings, onChange, driveId = null) {
    this.source = source;
    this.settings = settings;
    this.onChange = onChange;
    this.driveId = driveId;
    /** @type {Status} */
    this.status = "ready";
    /** @type {Step} */
    this.step = "files";
    /** Scans done and in all, in the step of scans; or what the service counts while it checks. */
    this.done = 0;
    this.total = 0;
    /** Of what the service does, while it checks. @type {number | null} */
    this.secondsLeft = null;
    /** What is going on, in words. */
    this.message = "";
    /** @type {FileProblem[]} */
    this.problems = [];
    /** @type {{title: string, detail: string} | null} */
    this.error = null;
    /** @type {string | null} */
    this.jobId = null;
    this.transfer = new Transfer(onChange);
  }

  /** @returns {number | null} How much of the scans or the archive was sent, 0..1; null before and after. */
  get sent() {
    const isSending = this.step === "scans" || this.step === "archive";
    return isSending ? this.transfer.meter.fraction : null;
  }

  /** @returns {Step[]} */
  get steps() {
    const { archive, drive } = this.source;
    /** @type {Step[]} */
    const sending = archive ? ["archive"] : ["plan", "files", "scans"];
    if (drive && !drive.look.scans) sending.shift(); // nothing to plan: only the service reads it, or it is reduced
    return [...sending, "check", ...(this.settings.job ? [/** @type {Step} */ ("run")] : [])];
  }

  get isRunning() {
    return this.status === "running" || this.status === "paused";
  }

  pause() {
    this.transfer.pause();
    this.#update({ status: "paused" });
  }

  resume() {
    this.#update({ status: "running" });
    this.transfer.resume();
  }

  /** Leave it as it is; it can go on later. */
  stop() {
    this.transfer.stop();
  }

  /** Do all steps; to be called again after a failure. */
  async run() {
    if (this.isRunning) return;
    this.transfer = new Transfer(this.onChange);
    this.#update({ status: "running", error: null, problems: [], message: "", step: this.steps[0] });
    try {
      await alone(this.source.fingerprint, async () => {
        const state = await this.#openDrive();
        if (state === "uploading") await this.#send();
        await this.#commit();
        if (this.settings.job) await this.#startJob(this.settings.job);
        if (this.driveId) forget(this.driveId);
      });
      this.#update({ status: "done", message: "" });
    } catch (error) {
      this.#fail(error);
    }
  }

  /** @param {Partial<Upload>} changes */
  #update(changes) {
    Object.assign(this, changes);
    this.onChange();
  }

  /** @param {unknown} error */
  #fail(error) {
    if (error instanceof DOMException && error.name === "AbortError") {
      this.#update({ status: "stopped" });
    } else if (error instanceof Refusal || error instanceof ApiError) {
      const { title, message: detail, problems } = error;
      this.#update({ status: "failed", error: { title, detail }, problems: sorted(problems) });
    } else {
      const detail = error instanceof Error ? error.message : String(error);
      this.#update({ status: "failed", error: { title: "The upload stopped", detail } });
    }
  }

  /** @returns {Promise<string>} State of the drive. */
  async #openDrive() {
    const { name, options, keepRaw } = this.settings;
    if (this.driveId) {
      this.transfer.drive = this.driveId;
      const { body } = await this.transfer.ask(`drives/${this.driveId}`);
      return body.state;
    }
    const { body } = await this.transfer.ask("drives", { method: "POST", json: { name, keep_raw: keepRaw, options } });
    this.driveId = body.id;
    this.transfer.drive = body.id;
    if (this.source.drive) this.#remember(this.source.fingerprint);
    return body.state;
  }

  /** @param {string} fingerprint @param {Record<string, string>} [schemes] */
  #remember(fingerprint, schemes) {
    const { drive } = this.source;
    const driveId = /** @type {string} */ (this.driveId);
    const before = remembered(driveId);
    const at = before?.at ?? new Date().toISOString();
    const { settings } = this;
    const root = drive?.look.root ?? "";
    schemes ??= before?.schemes;
    const isLoose = drive?.folder.isLoose;
    remember({ driveId, fingerprint, name: settings.name, at, root, isLoose, settings, schemes });
  }

  async #send() {
    const { archive, drive, extras } = this.source;
    const { meter } = this.transfer;
    if (archive) {
      meter.total = bytesOf(extras.values());
      await this.#sendArchive(archive);
      await sendSmallFiles(this.transfer, extras, new Map());
      return;
    }
    if (!drive) throw new Refusal("Nothing to send", "Pick the folder of a drive.");
    const { folders, sending, options } = this.settings;
    const isReduced = drive.look.layout === "reduced";
    if (drive.look.scans) await this.#lookAgain(drive);
    this.#update({ step: "files", message: "" });
    const isPlanned = drive.look.plan && sending !== "raw" && !madeFolder(options);
    const maps = [...extras].filter(([path]) => isMap(path));
    const small = isPlanned ? plannedFiles(drive, extras) : new Map([...drive.small, ...extras]);
    for (const [path, file] of maps) small.set(path, file);
    small.delete("reduced.json"); // it makes a drive of the rest, so it goes last
    meter.total = bytesOf(small.values());
    const present = await listPresent(this.transfer);
    await sendSmallFiles(this.transfer, small, present);
    // The very same files were sent before: what the service has of them is good.
    const isSame = remembered(/** @type {string} */ (this.driveId))?.fingerprint === this.source.fingerprint;
    if (!isSame) this.#remember(""); // old and new files are mixed until all is sent
    if (isPlanned) await this.#sendScans(drive, present, isSame);
    else await this.#sendAll(rawFiles(drive, isReduced || madeFolder(options) ? [] : folders), present, isSame);
    const manifest = drive.small.get("reduced.json");
    if (isReduced && manifest) await this.transfer.put("reduced.json", manifest);
    this.#remember(this.source.fingerprint);
  }

  /** @param {DriveFolder} drive @param {Present} present @param {boolean} isSame */
  async #sendScans(drive, present, isSame) {
    const { folders, name } = this.settings;
    const { labels, plan } = drive.look;
    const keyOf = (/** @type {string} */ folder) => JSON.stringify([labels[folder].road, labels[folder].confusable]);
    const keys = Object.fromEntries(folders.map((folder) => [folder, keyOf(folder)]));
    const before = remembered(/** @type {string} */ (this.driveId))?.schemes ?? {};
    const trusted = new Set(isSame ? folders.filter((folder) => before[folder] === keys[folder]) : []);
    this.#remember(isSame ? this.source.fingerprint : "", keys);
    const frames = numbersOf(plan?.kept ?? []);
    this.#update({ step: "scans", message: "", done: 0, total: frames.length * folders.length });
    const what = { drive, frames, folders, groundBytes: groundBytesOf(drive, folders), present, trusted };
    await sendReduced(this.transfer, what, (done) => this.#update({ done }));
    await this.transfer.put("reduced.json", manifestBytes(drive, name, folders));
  }

  /** @param {[string, File][]} files @param {Present} present @param {boolean} isSame */
  async #sendAll(files, present, isSame) {
    this.transfer.meter.total += bytesOf(files.map(([, file]) => file));
    this.#update({ step: "scans", message: "", done: 0, total: files.length });
    await sendFiles(this.transfer, files, present, isSame, (done) => this.#update({ done }));
  }

  /** Let the service say what to send, by the settings as they are now. @param {DriveFolder} drive */
  async #lookAgain(drive) {
    this.#update({ step: "plan", message: "Reading poses and georeference" });
    const { folders, options, sending, keyframes } = this.settings;
    const extras = new Map([...this.source.extras].filter(([path]) => !isMap(path)));
    const wish = { root: drive.look.root, options, extras, keyframes: sending === "scans" ? null : keyframes };
    const ask = async (/** @type {object} */ json) =>
      (await this.transfer.ask("drives/look", { method: "POST", json })).body;
    const { drive: found } = await lookInto(drive.folder, wish, ask);
    if (!found) throw new Refusal("The folder has changed", "It holds no drive any more. Pick it again.");
    Object.assign(drive, found);
    const ofLabels = madeFolder(options) ? [] : folders.flatMap((name) => found.look.labels[name]?.problems ?? []);
    this.#update({ problems: sorted([...found.look.problems, ...ofLabels]) });
    const isBad = (/** @type {FileProblem[]} */ problems) => problems.some(({ severity }) => severity === "error");
    const sent = "Nothing was sent so far.";
    if (isBad(found.look.problems)) {
      const detail = `${sent} Correct what is listed, then go on.`;
      throw new Refusal("This drive cannot be used yet", detail, this.problems);
    }
    if (isBad(ofLabels)) {
      const detail = `${sent} Choose another label scheme, then go on.`;
      throw new Refusal("The labels do not fit", detail, this.problems);
    }
  }

  /** @param {File} archive */
  async #sendArchive(archive) {
    this.transfer.meter.total += archive.size;
    this.#update({ step: "archive", message: "Sending the archive" });
    const answer = await this.transfer.send(`drives/${this.driveId}/archive`, archive, { method: "POST" });
    this.#update({ message: "Unpacking" });
    for (let job = await this.#latestJob("unpack"); job && job.state !== "successful"; ) {
      if (job.state === "failed" || job.state === "dismissed") {
        const error = job.error ?? { status: 422, title: "Stopped", detail: "The work was stopped." };
        throw new ApiError(error.status ?? 422, error);
      }
      this.#update({ done: job.progress.done, total: job.progress.total ?? 0 });
      await sleep(POLL_MS, this.transfer.signal);
      this.transfer.signal.throwIfAborted();
      job = await this.#latestJob("unpack");
    }
    this.#update({ message: answer?.files ? `${answer.files} files` : "" });
  }

  /** Let the service check and reduce the drive. */
  async #commit() {
    this.#update({ step: "check", message: "Checking the drive", done: 0, total: 0, secondsLeft: null });
    const json = { options: this.settings.options, keep_raw: this.settings.keepRaw };
    const headers = { Prefer: `wait=${COMMIT_WAIT_S}` }; // the same commit again joins the one that runs
    for (;;) {
      await this.transfer.waitWhilePaused();
      const path = `drives/${this.driveId}/commit`;
      const { status, body } = await this.transfer.ask(path, { method: "POST", json, headers });
      if (status !== 202) return this.#update({ problems: sorted(body.report?.problems ?? []) });
      const job = await this.#latestJob("commit");
      if (!job) continue;
      const { progress, stage } = job;
      const message = job.message ?? STAGES[stage] ?? "Checking the drive";
      this.#update({ done: progress.done, total: progress.total ?? 0, secondsLeft: progress.seconds_left, message });
    }
  }

  /** @param {"unpack" | "commit"} kind */
  async #latestJob(kind) {
    const { body } = await this.transfer.ask(`jobs?drive=${this.driveId}&kind=${kind}&limit=1`);
    return body.jobs[0] ?? null;
  }

  /** @param {JobSettings} settings */
  async #startJob({ key, osm: map, ...settings }) {
    this.#update({ step: "run", message: "Starting the job", done: 0, total: 0, secondsLeft: null });
    const osm = map && "inside" in map ? await this.#mapInside() : map;
    const placing = osm ? {} : { georeference: "drive", near: null }; // an archive without a map
    const json = { drive_id: this.driveId, ...settings, osm, ...placing };
    const headers = { "Idempotency-Key": key };
    const { body } = await this.transfer.ask("jobs", { method: "POST", json, headers });
    this.jobId = body.id;
  }

  /** @returns {Promise<{file: string} | null>} The map that an archive held. */
  async #mapInside() {
    const file = [...(await listPresent(this.transfer)).keys()].find(isMap);
    return file ? { file } : null;
  }
}

/**
 * Do something that no other tab does: locks are not there over plain http, where two tabs send the same files twice.
 *
 * @param {string} fingerprint Of the files; "" where they have none.
 * @param {() => Promise<void>} work
 */
async function alone(fingerprint, work) {
  if (!fingerprint || !navigator.locks) return work();
  await navigator.locks.request(`interloc.upload.${fingerprint}`, { ifAvailable: true }, (lock) => {
    if (lock) return work();
    throw new Refusal("Another tab sends this drive", "Wait for its end there, or stop it there and go on here.");
  });
}

/**
 * About how large the ground points of a scan are, by all label folders together.
 *
 * @param {DriveFolder} drive
 * @param {string[]} folders
 */
export function groundBytesOf({ look }, folders) {
  const points = look.points_per_scan ?? 0;
  const shares = folders.reduce((sum, name) => sum + (look.labels[name]?.ground_share ?? 0), 0);
  return shares * points * GROUND_POINT_BYTES;
}

/** Something that prevents the upload and that the person can correct. */
export class Refusal extends Error {
  /** @param {string} title @param {string} detail @param {FileProblem[]} [problems] */
  constructor(title, detail, problems = []) {
    super(detail);
    this.title = title;
    this.problems = problems;
  }
}
