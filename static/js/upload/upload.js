/** One upload from the first file to the job: every step can be repeated, so it goes on where it stopped. */

import { ApiError, isMap, sleep } from "../api.js";
import { inFolder, lookInto, numbersOf, pathOf, plannedFiles, rawFiles, sorted } from "./drive_folder.js";
import { Transfer } from "./transfer.js";

/** @import { FileProblem } from "../api.js" */
/** @import { JobSettings } from "../job/job_form.js" */
/** @import { DriveFolder, DriveLook, NumberedLook } from "./drive_folder.js" */
/** @import { Item } from "./transfer.js" */
/**
 * @typedef {object} Settings
 * @property {string} name
 * @property {string[]} folders Label folders that are sent.
 * @property {"keyframes" | "raw"} sending Ground points of keyframes, or everything as it is.
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
 */

/** @param {ReadingOptions} options @returns {"geometry" | "predictions" | null} Labels that the service makes. */
const madeFolder = ({ labels, model }) => labels ?? (model ? "predictions" : null);

/** @typedef {"plan" | "files" | "archive" | "check" | "run"} Step */
/** @typedef {"ready" | "running" | "failed" | "stopped" | "done"} Status */

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
   * @param {string | null} [driveId] Of an upload that was begun before.
   */
  constructor(source, settings, driveId = null) {
    this.source = source;
    this.settings = settings;
    this.onChange = () => {};
    this.driveId = driveId;
    /** Whether the drive holds nothing from before. */
    this.isNew = driveId === null;
    /** @type {Status} */
    this.status = "ready";
    /** @type {Step} */
    this.step = "files";
    /** Files that are there and in all; or what the service counts while it checks. */
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
    this.transfer = new Transfer(this.onChange);
  }

  /** @returns {number | null} How much of the files or the archive was sent, 0..1; null before and after. */
  get sent() {
    return this.step === "files" || this.step === "archive" ? this.transfer.meter.fraction : null;
  }

  /** @returns {Step[]} */
  get steps() {
    const { archive, drive } = this.source;
    /** @type {Step[]} Nothing is planned where only the service reads the scans, or they are reduced. */
    const sending = archive ? ["archive"] : drive?.look.scans ? ["plan", "files"] : ["files"];
    return [...sending, "check", ...(this.settings.job ? [/** @type {Step} */ ("run")] : [])];
  }

  get isRunning() {
    return this.status === "running";
  }

  /** Leave it as it is; it can go on later. */
  stop() {
    this.transfer.stop();
  }

  /** Do all steps; to be called again after a failure. */
  async run() {
    if (this.isRunning) return;
    this.transfer = new Transfer(this.onChange, this.transfer.arrived);
    this.#update({ status: "running", error: null, problems: [], message: "", step: this.steps[0] });
    try {
      const state = await this.#openDrive();
      if (state === "uploading") await this.#send();
      await this.#commit();
      if (this.settings.job) await this.#startJob(this.settings.job);
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
      try {
        const { body } = await this.transfer.ask(`drives/${this.driveId}`);
        return body.state;
      } catch (error) {
        if (!(error instanceof ApiError && error.status === 404)) throw error;
        this.isNew = true; // it was deleted elsewhere: begun anew
      }
    }
    const { body } = await this.transfer.ask("drives", { method: "POST", json: { name, keep_raw: keepRaw, options } });
    this.driveId = body.id;
    this.transfer.drive = body.id;
    return body.state;
  }

  async #send() {
    const { archive, drive, extras } = this.source;
    if (archive) {
      await this.#sendArchive(archive).catch((error) => this.#giveBack(error));
      await this.transfer.sendAll([...extras].map(asItem), () => {});
      return;
    }
    if (!drive) throw new Refusal("Nothing to send", "Pick the folder of a drive.");
    if (drive.look.scans) await this.#lookAgain(drive);
    const { name, folders, sending, options } = this.settings;
    const made = madeFolder(options);
    const plan = sending === "raw" || made ? null : drive.look.plan;
    const small = plan ? plannedFiles(drive, extras) : new Map([...drive.small, ...extras]);
    for (const [path, file] of extras) if (isMap(path)) small.set(path, file);
    const manifest = plan ? manifestFile(plan, name, folders) : small.get("reduced.json");
    small.delete("reduced.json"); // it makes a drive of the rest, so it goes last
    const whole = plan ? [] : rawFiles(drive, drive.look.layout === "reduced" || made ? [] : folders);
    const items = [...[...small, ...whole].map(asItem), ...(plan ? scanItems(drive, plan, folders) : [])];
    this.#update({ step: "files", message: "", done: 0, total: items.length });
    if (!this.isNew) await this.transfer.removeOthers(new Set(items.map(({ path }) => path)));
    await this.transfer.sendAll(items, (done) => this.#update({ done }));
    if (manifest) await this.transfer.sendAll([asItem(["reduced.json", manifest])], () => {});
  }

  /** Let the service say what to send, by the settings as they are now. @param {DriveFolder} drive */
  async #lookAgain(drive) {
    this.#update({ step: "plan", message: "Reading poses and georeference" });
    const { folders, options, keyframes } = this.settings;
    const extras = new Map([...this.source.extras].filter(([path]) => !isMap(path)));
    const wish = { root: drive.look.root, options, extras, keyframes };
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

  /** Remove the drive that was made for an archive, if that is refused: nothing in it can go on. @param {unknown} error */
  async #giveBack(error) {
    if (this.isNew && error instanceof ApiError && !error.isPassing) {
      const asked = this.transfer.ask(`drives/${this.driveId}`, { method: "DELETE" });
      await asked.then(() => (this.driveId = null)).catch(() => null); // the archive's own fault is what counts
    }
    throw error;
  }

  /** Let the service check and reduce the drive. */
  async #commit() {
    this.#update({ step: "check", message: "Checking the drive", done: 0, total: 0, secondsLeft: null });
    const json = { options: this.settings.options, keep_raw: this.settings.keepRaw };
    const headers = { Prefer: `wait=${COMMIT_WAIT_S}` }; // the same commit again joins the one that runs
    for (;;) {
      this.transfer.signal.throwIfAborted();
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
    const file = [...(await this.transfer.present()).keys()].find(isMap);
    return file ? { file } : null;
  }
}

/** @param {[path: string, file: File]} entry @returns {Item} */
const asItem = ([path, file]) => ({ path, file, size: file.size });

/**
 * The ground points of scans, which workers make.
 *
 * @param {DriveFolder} drive
 * @param {NonNullable<DriveLook["plan"]>} plan
 * @param {string[]} folders Of labels.
 * @returns {Item[]}
 */
function scanItems(drive, plan, folders) {
  const fileOf = (/** @type {string} */ path) => drive.folder.files.get(inFolder(drive, path));
  const size = groundBytesOf(drive, folders) / folders.length;
  const taskOf = (/** @type {number} */ frame, /** @type {string} */ folder) => {
    const scanName = pathOf(/** @type {NumberedLook} */ (drive.look.scans), frame);
    const labelName = pathOf(drive.look.labels[folder], frame);
    const files = { scan: fileOf(scanName), labels: fileOf(labelName), scanName, labelName };
    if (!files.labels) throw new Error(`${labelName}: is missing. Expected one .label file per scan.`);
    const { road, confusable } = drive.look.labels[folder];
    return { files, scheme: { road, confusable } };
  };
  return numbersOf(plan.kept).flatMap((frame) =>
    folders.map((folder) => {
      const path = `ground/${folder}/${String(frame).padStart(6, "0")}.ground`;
      return { path, size, task: () => taskOf(frame, folder) };
    }),
  );
}

/** @param {NonNullable<DriveLook["plan"]>} plan @param {string} name @param {string[]} folders Of labels. */
function manifestFile({ manifest }, name, folders) {
  const labels = manifest.labels.filter((/** @type {any} */ { folder }) => folders.includes(folder));
  const text = JSON.stringify({ ...manifest, name: name.replaceAll("/", "_"), labels }, null, 1);
  return new File([`${text}\n`], "reduced.json");
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
class Refusal extends Error {
  /** @param {string} title @param {string} detail @param {FileProblem[]} [problems] */
  constructor(title, detail, problems = []) {
    super(detail);
    this.title = title;
    this.problems = problems;
  }
}
