/** One upload from the first file to the job: every step can be repeated, so it goes on where it stopped. */

import { ApiError } from "../api.js";
import { checkAndKeep, waitForWork } from "./committing.js";
import { submitJob } from "./job_request.js";
import { forget, remember, remembered } from "./memory.js";
import { runsOf, sorted } from "./numbered.js";
import { groundBytesOf, judgeLabels } from "./schemes.js";
import { listPresent, manifestBytes, rawFiles, sendFiles, sendReduced, sendSmallFiles } from "./sending.js";
import { Transfer } from "./transfer.js";

/** @typedef {import("./numbered.js").FileProblem} FileProblem */

/**
 * @typedef {object} Settings
 * @property {string} name
 * @property {string[]} folders Label folders that are sent.
 * @property {"keyframes" | "scans" | "raw"} sending Ground points of keyframes, of every scan, or everything as it is.
 * @property {boolean} keepRaw
 * @property {{label_scheme: string, pose_frame: string, layout: string, oxts: string | null}} options
 * @property {{distance_m: number, angle_deg: number}} keyframes
 * @property {import("./job_request.js").JobSettings | null} job null: only upload.
 */

/**
 * @typedef {object} Source What was picked.
 * @property {import("./drive_folder.js").DriveFolder | null} drive
 * @property {File | null} archive
 * @property {Map<string, File>} extras Files from elsewhere, by their paths in the drive: a map, a georeference.
 * @property {FileSystemDirectoryHandle | null} handle
 * @property {string} fingerprint
 */

/** @typedef {"files" | "plan" | "scans" | "archive" | "check" | "run"} Step */
/** @typedef {"ready" | "running" | "paused" | "failed" | "stopped" | "done"} Status */

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
    /** What is going on, in words. */
    this.message = "";
    /** @type {FileProblem[]} */
    this.problems = [];
    /** @type {{title: string, detail: string} | null} */
    this.error = null;
    /** What the service made of the small files. @type {any} */
    this.plan = null;
    /** @type {any} */
    this.report = null;
    /** @type {string | null} */
    this.jobId = null;
    this.transfer = new Transfer(onChange);
  }

  /** @returns {Step[]} */
  get steps() {
    const { archive, drive } = this.source;
    /** @type {Step[]} */
    const sending = archive
      ? ["archive"]
      : drive?.layout === "reduced"
        ? ["files", "scans"]
        : ["files", "plan", "scans"];
    return [...sending, "check", ...(this.settings.job ? [/** @type {Step} */ ("run")] : [])];
  }

  get isRunning() {
    return this.status === "running" || this.status === "paused";
  }

  pause() {
    this.transfer.pause();
    this.#say({ status: "paused" });
  }

  resume() {
    this.#say({ status: "running" });
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
    this.#say({ status: "running", error: null, problems: [], message: "", step: this.steps[0] });
    try {
      const state = await this.#openDrive();
      if (state === "uploading") await this.#send();
      await this.#commit();
      await this.#startJob();
      if (this.driveId) forget(this.driveId);
      this.#say({ status: "done" });
    } catch (error) {
      this.#fail(error);
    }
  }

  /** @param {Partial<Upload>} changes */
  #say(changes) {
    Object.assign(this, changes);
    this.onChange();
  }

  /** @param {unknown} error */
  #fail(error) {
    if (error instanceof DOMException && error.name === "AbortError") {
      this.#say({ status: "stopped" });
    } else if (error instanceof Refusal || error instanceof ApiError) {
      const problems = /** @type {FileProblem[]} */ (error.problems);
      this.#say({ status: "failed", error: { title: error.title, detail: error.message }, problems: sorted(problems) });
    } else {
      const detail = error instanceof Error ? error.message : String(error);
      this.#say({ status: "failed", error: { title: "The upload stopped", detail } });
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
    const id = /** @type {string} */ (this.driveId);
    const before = remembered(id);
    remember(
      {
        driveId: id,
        fingerprint,
        name: this.settings.name,
        at: before?.at ?? new Date().toISOString(),
        root: drive?.root ?? "",
        settings: this.settings,
        schemes: schemes ?? before?.schemes,
      },
      handle,
    );
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
    const isTrusted = this.isSame();
    if (!isTrusted) this.#remember(""); // old and new files are mixed until all is sent
    if (drive.layout === "reduced") await this.#sendAll([...drive.ground], present, isTrusted);
    else await this.#sendScans(drive, present, isTrusted);
    const manifest = drive.small.get("reduced.json");
    if (drive.layout === "reduced" && manifest) await this.transfer.put("reduced.json", manifest);
    this.#remember(this.source.fingerprint);
  }

  /** True where the very same files were sent before: what the service has of them is good. */
  isSame() {
    return remembered(/** @type {string} */ (this.driveId))?.fingerprint === this.source.fingerprint;
  }

  /**
   * @param {import("./drive_folder.js").DriveFolder} drive
   * @param {import("./sending.js").Present} present
   * @param {boolean} isTrusted
   */
  async #sendScans(drive, present, isTrusted) {
    const { folders, sending } = this.settings;
    this.#say({ step: "plan", message: "Reading poses and georeference" });
    const plan = await this.#askPlan(drive);
    const judged = await this.#judge(drive, plan);
    if (sending === "raw") {
      await this.#sendAll(rawFiles(drive, folders), present, isTrusted);
      return;
    }
    const schemes = new Map([...judged].map(([folder, { scheme }]) => [folder, scheme]));
    const keys = Object.fromEntries(
      [...schemes].map(([folder, scheme]) => [folder, JSON.stringify([scheme.road, scheme.confusable])]),
    );
    const before = remembered(/** @type {string} */ (this.driveId))?.schemes ?? {};
    const trusted = new Set(isTrusted ? folders.filter((folder) => before[folder] === keys[folder]) : []);
    this.#remember(isTrusted ? this.source.fingerprint : "", keys);
    const { frames, manifest } = plan;
    this.#say({ step: "scans", message: "", done: 0, total: frames.length * schemes.size });
    const groundBytes = groundBytesOf(drive, judged.values()) / schemes.size;
    await sendReduced(this.transfer, { drive, frames, schemes, groundBytes, present, trusted }, (done) =>
      this.#say({ done }),
    );
    await this.transfer.put("reduced.json", manifestBytes(manifest, drive, judged));
  }

  /** @param {[string, File][]} files @param {import("./sending.js").Present} present @param {boolean} isTrusted */
  async #sendAll(files, present, isTrusted) {
    this.transfer.meter.total += files.reduce((sum, [, file]) => sum + file.size, 0);
    this.#say({ step: "scans", message: "", done: 0, total: files.length });
    await sendFiles(this.transfer, files, present, isTrusted, (done) => this.#say({ done }));
  }

  /** @param {import("./drive_folder.js").DriveFolder} drive */
  async #askPlan(drive) {
    const { folders, options, sending } = this.settings;
    const keyframes = sending === "scans" ? null : this.settings.keyframes;
    const scans = /** @type {import("./numbered.js").NumberedFiles} */ (drive.scans);
    const runs = runsOf(scans.files.keys());
    const [first, count] = runs[0];
    const numbers = runs.length === 1 ? { first, last: first + count - 1 } : [...scans.files.keys()];
    const json = { scans: numbers, label_folders: folders, options, keyframes, scan_folder: scans.folder };
    const { body } = await this.transfer.ask(`drives/${this.driveId}/plan`, { method: "POST", json });
    this.#say({ plan: body, problems: sorted(body.problems) });
    if (body.problems.some((/** @type {FileProblem} */ each) => each.severity === "error") || !body.manifest) {
      throw new Refusal(
        "This drive cannot be used yet",
        "Nothing but small files was sent so far. Mend what is listed, then go on.",
        body.problems,
      );
    }
    return body;
  }

  /** @param {import("./drive_folder.js").DriveFolder} drive @param {any} plan */
  async #judge(drive, plan) {
    const frames = plan.frames_to_look_into;
    const judged = new Map();
    for (const folder of this.settings.folders) {
      const found = await judgeLabels(
        drive.labels[folder],
        frames,
        this.settings.options.label_scheme,
        plan.layout === "kitti360",
      );
      judged.set(folder, found);
      this.problems = sorted([...this.problems, ...found.problems]);
    }
    if (this.problems.some((each) => each.severity === "error")) {
      throw new Refusal(
        "The labels do not fit",
        "Nothing but small files was sent so far. Choose another label scheme, then go on.",
        this.problems,
      );
    }
    return judged;
  }

  /** @param {File} archive */
  async #sendArchive(archive) {
    this.transfer.meter.total += archive.size;
    this.#say({ step: "archive", message: "Sending the archive" });
    const headers = { "Content-Type": "application/octet-stream" };
    const answer = await this.transfer.send(`drives/${this.driveId}/archive`, archive, { method: "POST", headers });
    this.#say({ message: "Unpacking" });
    await waitForWork(this.transfer, "unpack", (job) =>
      this.#say({ done: job.progress.done, total: job.progress.total ?? 0 }),
    );
    this.#say({ message: answer?.files ? `${answer.files} files` : "" });
  }

  async #commit() {
    this.#say({ step: "check", message: "Checking the drive", done: 0, total: 0 });
    const { options, keepRaw } = this.settings;
    const request = { options, keep_raw: keepRaw };
    const drive = await checkAndKeep(this.transfer, request, (job) => {
      this.#say({
        done: job.progress.done,
        total: job.progress.total ?? 0,
        message: job.message ?? "Checking the drive",
      });
    });
    this.#say({ report: drive.report, problems: sorted(drive.report?.problems ?? []) });
  }

  async #startJob() {
    if (!this.settings.job) return;
    this.#say({ step: "run", message: "Starting the job", done: 0, total: 0 });
    this.jobId = await submitJob(this.transfer, /** @type {string} */ (this.driveId), this.settings.job);
  }
}

/** Something that stands in the way and that the person can mend. */
export class Refusal extends Error {
  /** @param {string} title @param {string} detail @param {FileProblem[]} [problems] */
  constructor(title, detail, problems = []) {
    super(detail);
    this.title = title;
    this.problems = problems;
  }
}
