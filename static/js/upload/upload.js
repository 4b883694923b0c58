/** One upload from the first file to the job: every step can be repeated, so it goes on where it stopped. */

import { ApiError, isMap, sleep } from "../api.js";
import { runsOf, sorted } from "./drive_folder.js";
import { forget, remember, remembered } from "./memory.js";
import { countLabels } from "./reduce.js";
import { listPresent, manifestBytes, rawFiles, sendFiles, sendReduced, sendSmallFiles } from "./sending.js";
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

/**
 * @typedef {object} ReadingOptions How the service reads the files.
 * @property {string} label_scheme
 * @property {string} pose_frame
 * @property {string} layout
 * @property {string | null} oxts
 * @property {string | null} poses File of the poses, or their topic in a bag.
 * @property {string | null} points Topic of the scans in a bag.
 * @property {string | null} fix Topic of the GNSS fixes in a bag.
 * @property {string | null} crs Coordinate system of LAS files.
 * @property {string | null} frames Part of the drive, as FROM:TO.
 * @property {"geometry"} [labels] Labels that the service makes of the points.
 * @property {string} [model] Network of the service that labels the scans.
 */

/**
 * @typedef {object} Source What was picked.
 * @property {DriveFolder | null} drive
 * @property {File | null} archive
 * @property {Map<string, File>} extras Files from elsewhere, by their paths in the drive: a map, a georeference.
 * @property {FileSystemDirectoryHandle | null} handle
 * @property {string} fingerprint
 */

/**
 * @typedef {object} JudgedLabels What the service makes of the label ids of a folder.
 * @property {string} folder
 * @property {string | null} scheme
 * @property {number[]} road
 * @property {number[]} confusable
 * @property {number | null} road_share
 * @property {number | null} ground_share Of road, sidewalk, parking and other ground: what is left of a scan.
 * @property {FileProblem[]} problems
 */

/** @param {ReadingOptions} options @returns {"geometry" | "predictions" | null} Labels that the service makes. */
export const madeFolder = ({ labels, model }) => labels ?? (model ? "predictions" : null);

/** @typedef {"files" | "plan" | "scans" | "archive" | "check" | "run"} Step */
/** @typedef {"ready" | "running" | "paused" | "failed" | "stopped" | "done"} Status */
/** @typedef {Record<string, Record<string, number>>} LabelCounts Folder -> label id -> number of points. */

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
    /** What the service made of the small files and the labels. @type {any} */
    this.plan = null;
    /** @type {string | null} */
    this.jobId = null;
    this.transfer = new Transfer(onChange);
    /** Asked before each run; it throws where the upload must not run now. @type {() => Promise<void>} */
    this.guard = async () => {};
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
    const sending = archive ? ["archive"] : ["files", "plan", "scans"];
    if (drive && !drive.scans) sending.splice(1, 1); // nothing to plan: only the service reads it, or it is reduced
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
      await this.guard();
      const state = await this.#openDrive();
      if (state === "uploading") await this.#send();
      await this.#commit();
      if (this.settings.job) await this.#startJob(this.settings.job);
      if (this.driveId) forget(this.driveId);
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
    const { drive, handle } = this.source;
    const driveId = /** @type {string} */ (this.driveId);
    const before = remembered(driveId);
    const at = before?.at ?? new Date().toISOString();
    const { settings } = this;
    const root = drive?.root ?? "";
    schemes ??= before?.schemes;
    const isLoose = drive?.isLoose;
    remember({ driveId, fingerprint, name: settings.name, at, root, isLoose, settings, schemes }, handle);
  }

  async #send() {
    const { archive, drive, extras } = this.source;
    const { meter } = this.transfer;
    meter.total = [...(drive?.small.values() ?? []), ...extras.values()].reduce((sum, file) => sum + file.size, 0);
    if (archive) {
      await this.#sendArchive(archive);
      await sendSmallFiles(this.transfer, extras, new Map());
      return;
    }
    if (!drive) throw new Refusal("Nothing to send", "Pick the folder of a drive.");
    const present = await listPresent(this.transfer);
    const small = new Map([...drive.small, ...extras]);
    small.delete("reduced.json"); // it makes a drive of the rest, so it goes last
    await sendSmallFiles(this.transfer, small, present);
    // The very same files were sent before: what the service has of them is good.
    const isSame = remembered(/** @type {string} */ (this.driveId))?.fingerprint === this.source.fingerprint;
    if (!isSame) this.#remember(""); // old and new files are mixed until all is sent
    if (drive.layout === "reduced") await this.#sendAll([...drive.ground], present, isSame);
    else if (!drive.scans) await this.#sendAll(rawFiles(drive, this.settings.folders), present, isSame);
    else await this.#sendScans(drive, present, isSame);
    const manifest = drive.small.get("reduced.json");
    if (drive.layout === "reduced" && manifest) await this.transfer.put("reduced.json", manifest);
    this.#remember(this.source.fingerprint);
  }

  /** @param {DriveFolder} drive @param {Present} present @param {boolean} isSame */
  async #sendScans(drive, present, isSame) {
    const { folders, sending, options } = this.settings;
    this.#update({ step: "plan", message: "Reading poses and georeference" });
    const made = madeFolder(options);
    const labels = made ? [] : folders;
    if (drive.look?.has_poses === false) {
      await this.#sendAll(rawFiles(drive, labels), present, isSame);
      return;
    }
    const plan = await this.#askPlan(drive, await countFolders(drive, labels));
    if (made || sending === "raw") {
      await this.#sendAll(rawFiles(drive, labels), present, isSame);
      return;
    }
    /** @type {Map<string, JudgedLabels>} */
    const schemes = new Map(plan.labels.map((/** @type {JudgedLabels} */ each) => [each.folder, each]));
    const key = (/** @type {JudgedLabels} */ { road, confusable }) => JSON.stringify([road, confusable]);
    const keys = Object.fromEntries([...schemes].map(([folder, scheme]) => [folder, key(scheme)]));
    const before = remembered(/** @type {string} */ (this.driveId))?.schemes ?? {};
    const trusted = new Set(isSame ? folders.filter((folder) => before[folder] === keys[folder]) : []);
    this.#remember(isSame ? this.source.fingerprint : "", keys);
    const { frames, manifest } = plan;
    this.#update({ step: "scans", message: "", done: 0, total: frames.length * schemes.size });
    const groundBytes = groundBytesOf(drive, plan.labels) / schemes.size;
    const what = { drive, frames, schemes, groundBytes, present, trusted };
    await sendReduced(this.transfer, what, (done) => this.#update({ done }));
    await this.transfer.put("reduced.json", manifestBytes(manifest, drive));
  }

  /** @param {[string, File][]} files @param {Present} present @param {boolean} isSame */
  async #sendAll(files, present, isSame) {
    this.transfer.meter.total += files.reduce((sum, [, file]) => sum + file.size, 0);
    this.#update({ step: "scans", message: "", done: 0, total: files.length });
    await sendFiles(this.transfer, files, present, isSame, (done) => this.#update({ done }));
  }

  /**
   * Let the service read the small files, and judge the labels.
   *
   * @param {DriveFolder} drive
   * @param {LabelCounts} label_counts Of the scans that are looked into.
   */
  async #askPlan(drive, label_counts) {
    const { folders, options, sending } = this.settings;
    const made = madeFolder(options);
    const { files, folder } = /** @type {import("./drive_folder.js").NumberedFiles} */ (drive.scans);
    const [[first, count], ...others] = runsOf(files.keys());
    const json = {
      scans: others.length ? [...files.keys()] : { first, last: first + count - 1 },
      label_folders: made ? [made] : folders,
      label_counts,
      options,
      keyframes: sending === "scans" ? null : this.settings.keyframes,
      scan_folder: folder,
    };
    const { body: plan } = await this.transfer.ask(`drives/${this.driveId}/plan`, { method: "POST", json });
    const ofLabels = plan.labels.flatMap((/** @type {JudgedLabels} */ each) => each.problems);
    this.#update({ plan, problems: sorted([...plan.problems, ...ofLabels]) });
    const isBad = (/** @type {FileProblem[]} */ problems) => problems.some(({ severity }) => severity === "error");
    const sent = "Nothing but small files was sent so far.";
    if (isBad(plan.problems) || !plan.manifest) {
      const detail = `${sent} Correct what is listed, then go on.`;
      throw new Refusal("This drive cannot be used yet", detail, this.problems);
    }
    if (isBad(ofLabels)) {
      const detail = `${sent} Choose another label scheme, then go on.`;
      throw new Refusal("The labels do not fit", detail, this.problems);
    }
    return plan;
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
 * Count the label ids in some scans; only the browser has them.
 *
 * @param {DriveFolder} drive
 * @param {string[]} folders
 */
export async function countFolders(drive, folders) {
  const frames = drive.look?.frames_to_look_into ?? [];
  /** @type {LabelCounts} */
  const all = {};
  for (const folder of folders) {
    const labels = drive.labels[folder];
    all[folder] = {};
    for (const frame of frames) {
      const file = labels.files.get(frame);
      if (!file) continue;
      for (const [id, count] of await countLabels(file, `${folder}/${file.name}`)) {
        all[folder][id] = (all[folder][id] ?? 0) + count;
      }
    }
  }
  return all;
}

/**
 * About how large the ground points of a scan are, by all label folders together.
 *
 * @param {DriveFolder} drive
 * @param {JudgedLabels[]} labels
 */
export function groundBytesOf({ scans }, labels) {
  const points = scans ? scans.bytes / 16 / scans.files.size : 0;
  return labels.reduce((sum, { ground_share }) => sum + (ground_share ?? 0) * points * GROUND_POINT_BYTES, 0);
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
