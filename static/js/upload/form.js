/** The form between picking a folder and sending it: what was found, how to read it, what to do with it. */

import { ApiError, getConfig, isMap } from "../api.js";
import { factRows, field, filePicker, problemList, select } from "../controls.js";
import { el, fill, formatBytes, formatCount, formatMetres, icon, plural } from "../dom.js";
import { jobForm } from "../job/job_form.js";
import { bytesOf, inFolder, lookInto, problemsOf, sorted } from "./drive_folder.js";
import { folderOfInput } from "./folder.js";
import { labelForm } from "./label_form.js";
import { mapVerdict, showPreview } from "./preview.js";
import { readingForm } from "./reading_form.js";
import { groundBytesOf } from "./upload.js";

/** @import { FileProblem } from "../api.js" */
/** @import { DriveFolder, ListedName } from "./drive_folder.js" */
/** @import { Settings } from "./upload.js" */

const MORE_FILES = "poses.txt, calib.txt, times.txt, geo.csv or a trajectory, by the names that they have in a drive.";

const POSE_OWNERS = /** @type {Record<string, string>} */ ({
  ...{ camera: "of the camera", lidar: "of the LiDAR", imu: "of the IMU", oxts: "from OXTS" },
});

/**
 * @param {object} picked
 * @param {DriveFolder | null} picked.drive
 * @param {ListedName[]} picked.drives All in the folder.
 * @param {File | null} picked.archive
 * @param {any} picked.presets
 * @param {import("./label_form.js").Network[]} picked.networks Of the service; none where the drive has labels.
 * @param {Partial<Settings> | null} picked.before Settings to start from.
 * @param {object} actions
 * @param {(source: import("./upload.js").Source, settings: Settings) => void} actions.onStart
 * @param {() => void} actions.onBack
 * @param {(root: string) => void} actions.onChoose Another drive of the folder.
 */
export function formView({ drive, drives, archive, presets, networks, before }, { onStart, onBack, onChoose }) {
  const value = before?.name ?? drive?.look.name ?? baseName(archive);
  const name = el("input", { type: "text", required: true, maxLength: 200, value, onInput: refresh });
  const facts = el("dl.figures");
  const problems = el("div", { "aria-live": "polite" });
  const errors = el("div", { "aria-live": "assertive" });
  const added = el("span.small", { role: "status" });
  const isReduced = drive?.look.layout === "reduced";
  const isOpen = drive !== null && !isReduced; // there are a scheme and folders to choose
  const isRecorded = isOpen && drive.whole.size > 0;
  const canReduce = typeof CompressionStream === "function" && typeof Worker === "function";

  const listeners = { onChange: () => (refresh(), lookAgain()), onFolder: addPredictions };
  const labels = labelForm({ drive, networks, before }, listeners);
  const reading = readingForm(drive, before, () => (refresh(), lookAgain()));
  const checked = !canReduce || before?.sending === "raw";
  const asIs = el("input", { type: "checkbox", checked, disabled: !canReduce });
  asIs.addEventListener("change", refresh);
  const hint =
    "All scans whole; the service reduces them after it has checked them. Without it the browser sends what " +
    "the method needs, the ground points of keyframes: the smallest, with the same results.";
  const everything = el("label.check", asIs, el("span", "Send everything as it is", el("small", hint)));
  const keepRaw = el("input", { type: "checkbox", checked: before?.keepRaw ?? false });
  const keep = el("label.check", keepRaw, el("span", "Let the service keep the whole scans"));
  /** @returns {boolean} Whether the scans are sent as they are because only the service reads or labels them. */
  const isWhole = () => isRecorded || labels.made() !== null || drive?.look.has_poses === false;
  const sending = () => (isWhole() || asIs.checked ? "raw" : "keyframes");
  const whyWhole = el("p.small");
  const known = {
    maps: drive ? [...drive.maps.keys()] : [],
    isArchive: !drive,
    folders: drive ? labelNames(drive) : [],
    hasGeoreference: Boolean(drive && mayHaveFix(drive)),
    presets,
    before: before?.job ?? null,
  };
  const job = jobForm(known, refresh);

  /** The service labels the keyframes by these settings. @type {Settings["keyframes"]} */
  const usualKeyframes = presets.presets[0].config.keyframes;
  /** @type {FileProblem[]} What prevented the last look. */
  let faults = [];
  /** How the drive was read when it was looked into last. */
  let lookedWith = JSON.stringify(wish());

  /** What a look depends on. */
  function wish() {
    const fix = reading.georeference();
    const options = { ...reading.read(), oxts: fix?.path ?? null };
    return { options, fix: fix && [...fix.files.values()].map(({ size, lastModified }) => [size, lastModified]) };
  }

  /** Let the service look into the drive again, if it is to be read otherwise or files came. */
  async function lookAgain(isOther = false) {
    const { options } = wish();
    const mine = JSON.stringify(wish());
    if (!drive || (!isOther && mine === lookedWith) || reading.complaint() !== null) return;
    lookedWith = mine;
    const extras = reading.georeference()?.files;
    try {
      const { drive: next } = await lookInto(drive.folder, { root: drive.look.root, options, extras });
      if (mine !== lookedWith || !next) return; // asked again meanwhile
      Object.assign(drive, next);
      faults = [];
    } catch (fault) {
      if (mine !== lookedWith) return;
      const refused = fault instanceof ApiError ? fault.problems[0]?.message : null;
      const message = refused ?? (fault instanceof Error ? fault.message : String(fault));
      faults = [{ severity: "error", path: "options", message }];
    }
    update();
  }

  /** What is on the map. @type {import("./preview.js").Found | null} */
  let found = null;
  const isElsewhere = () => found?.look?.covered === 0 && job.read().job.georeference === "drive";
  /** Draw what is to be sent, and say how the map fits it. */
  function look() {
    if (!drive) return;
    const request = job.map.read();
    const map = job.map.ownFile() ?? (request && "file" in request ? drive.maps.get(request.file) : null) ?? null;
    showPreview(drive, map, (next) => {
      const before = isElsewhere();
      found = next;
      const [text, isBad] = map ? mapVerdict(map, next) : ["", false];
      job.map.setVerdict(text, isBad);
      if (isElsewhere() !== before) refresh();
      else showFacts();
    });
  }

  function showFacts() {
    if (!drive) return;
    const folders = isOpen ? labels.folders() : [];
    const rows = [
      ...factsOf(drive, folders, groundBytesOf(drive, folders), sending()),
      found?.track ? /** @type {[string, string]} */ (["Distance", formatMetres(found.track.length_m, 0)]) : null,
    ];
    fill(facts, factRows(rows));
  }

  /** @param {FileList} list */
  function addPredictions(list) {
    if (!drive) return;
    const folder = folderOfInput(list);
    const found = [...folder.files].filter(([path]) => path.endsWith(".label"));
    const places = [...new Set(found.map(([path]) => path.slice(0, path.lastIndexOf("/") + 1)))];
    const place = places.length > 1 ? places.find((path) => path.split("/").includes(drive.look.name)) : places[0];
    if (place === undefined) {
      const several = `holds labels of several drives; none of them is named ${drive.look.name}`;
      added.textContent = `${folder.name} ${places.length ? several : "holds no .label file"}.`;
      return;
    }
    const front = `${inFolder(drive, "predictions")}/`;
    for (const path of drive.folder.files.keys()) if (path.startsWith(front)) drive.folder.files.delete(path);
    const own = found.filter(([path]) => path.startsWith(place));
    for (const [path, file] of own) drive.folder.files.set(front + path.slice(place.length), file);
    added.textContent = "";
    lookAgain(true);
  }

  /** @param {FileList} list */
  async function addFiles(list) {
    if (!drive) return;
    const maps = [...list].filter(({ name }) => isMap(name));
    const others = [...list].filter(({ name }) => !isMap(name));
    for (const file of others) drive.folder.files.set(inFolder(drive, nameOf(file)), file);
    await lookAgain(true);
    const refused = [
      ...maps.map(({ name }) => `${name}: choose it as the map to score against.`),
      ...others
        .filter((file) => ![...drive.small.values()].includes(file))
        .map(({ name }) => `${name}: expected ${MORE_FILES}`),
    ];
    added.textContent = refused.join(" ");
  }

  /** After files came or went. */
  function update() {
    if (drive) {
      labels.setFolders(drive.look.labels);
      reading.setFiles();
    }
    refresh();
  }

  function refresh() {
    const fix = reading.georeference();
    const folders = isOpen ? labels.folders() : [];
    const made = labels.made();
    everything.hidden = isWhole();
    keep.hidden = sending() !== "raw";
    whyWhole.textContent = drive && isWhole() ? reasonOf(drive, made) : "";
    job.setFolders(made ? [made.folder] : drive && isReduced ? labelNames(drive) : folders);
    if (drive) {
      job.setGeoreference(mayHaveFix(drive) || fix !== null);
      showFacts();
      look();
    } else if (archive) {
      const size = /** @type {[string, string]} */ (["Size", formatBytes(archive.size)]);
      fill(facts, factRows([["Archive", archive.name], size]));
    }
    const list = drive ? sorted([...problemsOf(drive, folders, made !== null), ...faults]) : [];
    const isError = (/** @type {FileProblem} */ each) => each.severity === "error";
    const borrowed = drive?.look.borrowed.map((/** @type {string} */ text) => el("p.small", text));
    fill(errors, problemList(list.filter(isError)));
    fill(problems, problemList(list.filter((each) => !isError(each))), borrowed);
    const complaint = list.some(isError)
      ? "Correct what is listed as an error first: the service would refuse the drive."
      : !name.value.trim()
        ? "Give the drive a name."
        : (job.complaint() ??
          reading.complaint() ??
          (isOpen && !isWhole() && !folders.length ? "Choose a folder of labels." : null));
    const ofMap = isElsewhere() ? "Choose a map of where the drive was, or place the drive by its roads." : null;
    const ofLabels = made ? keyframesComplaint(job.keyframes(), usualKeyframes) : null;
    const ofRun = job.mapComplaint() ?? ofMap ?? ofLabels;
    only.disabled = complaint !== null;
    run.disabled = (complaint ?? ofRun) !== null;
    why.textContent = complaint ?? ofRun ?? "";
  }

  /** @param {boolean} withJob */
  function start(withJob) {
    const { job: request, map } = job.read();
    const fix = reading.georeference();
    const extras = new Map(fix?.files);
    if (map) extras.set(map.name, map);
    const own = !map && request.osm && "file" in request.osm ? drive?.maps.get(request.osm.file) : null;
    if (own) extras.set(/** @type {{file: string}} */ (request.osm).file, own);
    const isRaw = sending() === "raw";
    onStart(
      { drive, archive, extras },
      {
        name: name.value.trim(),
        folders: isOpen ? labels.folders() : [],
        sending: isReduced ? "raw" : sending(),
        keepRaw: isRaw && keepRaw.checked,
        options: { ...reading.read(), oxts: fix?.path ?? null, ...labels.made()?.options },
        keyframes: job.keyframes(),
        job: withJob ? request : null,
      },
    );
  }

  const run = el("button.primary.grow", { onClick: () => start(true) }, icon("run"), "Upload and run");
  const only = el("button", { onClick: () => start(false) }, "Upload only");
  const why = el("small", { role: "status" });
  const accept = ".txt,.csv,.tum,.sbet,.out,.yaml";
  const files = filePicker("Add files …", addFiles, { multiple: true, accept, class: "link", name: "more-files" });
  const other = el("button", { onClick: onBack }, "Choose another");
  const element = el("div.stack.upload-form", [
    el("div.spread", el("h2", "What to upload"), other),
    drive && drives.length > 1 && driveChooser(drive, drives, onChoose),
    errors,
    field("Name", name, "Shown in lists and results."),
    job.mapElement,
    el("div.box.stack-s", [facts, whyWhole, isOpen && el("div", files, " ", el("small", MORE_FILES)), added]),
    problems,
    !isReduced && labels.element,
    job.element,
    !isReduced && el("details", el("summary", "How the files are read"), reading.element),
    isOpen && el("details", { open: asIs.checked }, el("summary", "What is sent"), everything, keep),
    el("div.stack-s.foot", why, el("div.row", run, only)),
  ]);
  update();
  return element;
}

/** @param {DriveFolder} drive @param {ListedName[]} drives @param {(root: string) => void} onChoose */
function driveChooser(drive, drives, onChoose) {
  const options = Object.fromEntries(
    drives.map(({ root, name, kind, files }) => [
      `/${root}`,
      `${root || name} (${plural(files, kind === "rosbag" || kind === "las" ? "file" : "scan")})`,
    ]),
  );
  const choice = select(options, `/${drive.look.root}`, (root) => onChoose(root.slice(1)));
  return field(`${drives.length} drives are in the folder: which one?`, choice);
}

/** @param {File} file @returns {string} The poses of KITTI odometry are named after their sequence. */
const nameOf = ({ name }) => (/^\d\d\.txt$/.test(name) ? "poses.txt" : name);

/** @param {DriveFolder} drive @returns {boolean} Whether it has a georeference, or that is not known. */
const mayHaveFix = ({ look }) => look.georeference !== null || look.georeference_reason === null;

/** @param {DriveFolder} drive */
function labelNames({ look, whole }) {
  if (look.layout !== "reduced") return Object.keys(look.labels);
  return [...new Set([...whole.keys()].map((path) => path.split("/")[1]))].sort();
}

/** @param {File | null} archive */
const baseName = (archive) => archive?.name.replace(/\.(zip|tgz|tzst|tar(\.\w+)?)$/i, "") ?? "";

/**
 * @param {Settings["keyframes"]} wanted By the settings of the job.
 * @param {Settings["keyframes"]} labelled Those that the service labels.
 * @returns {string | null} Why the job could not run.
 */
function keyframesComplaint(wanted, labelled) {
  if (wanted.distance_m === labelled.distance_m && wanted.angle_deg === labelled.angle_deg) return null;
  const usual = `${labelled.distance_m} m and ${labelled.angle_deg}°`;
  return `The service labels the keyframes of ${usual}: leave these two settings, or use label files of your own.`;
}

/** @param {DriveFolder} drive @param {import("./label_form.js").MadeLabels | null} made @returns {string} Why its scans are sent as they are. */
function reasonOf({ look }, made) {
  const lacksPoses = look.has_poses === false && "The service computes the poses, so the scans are sent whole";
  const why = made?.why || lacksPoses || "The browser cannot reduce these files";
  return `${why}: all files are sent as they are, and the service keeps what the method needs.`;
}

/** @param {DriveFolder} drive */
function georeferenceOf({ look }) {
  if (look.georeference) return look.georeference;
  if (look.georeference_reason) return "none";
  if (look.layout === "rosbag") return "the fixes in the bag, if it has any";
  if (look.layout === "las") return "a geo.csv beside them, else the coordinate system that they name";
  return "not known yet";
}

/**
 * @param {DriveFolder} drive
 * @param {string[]} folders
 * @param {number} groundBytes What is left of a scan.
 * @param {string} sending
 * @returns {Parameters<typeof factRows>[0]}
 */
function factsOf(drive, folders, groundBytes, sending) {
  const { look, whole, maps, unused } = drive;
  const { scans, layout } = look;
  const taken = bytesOf(whole.values());
  const labelBytes = folders.reduce((sum, folder) => sum + (look.labels[folder]?.size_bytes ?? 0), 0);
  const all = formatBytes((scans?.size_bytes ?? taken) + labelBytes);
  const part = scans && `${formatBytes(groundBytes * scans.count)} of ${all}`;
  const sent = sending === "raw" ? all : `about ${part}`;
  const last = scans?.runs.at(-1) ?? [0, 0];
  const files = layout === "pcd" ? "scan" : "file";
  return [
    ["Layout", getConfig().layouts[layout ?? ""] ?? "not known yet"],
    scans && ["Scans", `${plural(scans.count, "scan")}, ${scans.runs[0][0]} to ${last[0] + last[1] - 1}`],
    scans && ["Points", `about ${formatCount(look.points_per_scan ?? 0)} per scan`],
    layout === "reduced" && ["Files of ground points", formatCount(whole.size)],
    layout !== "reduced" &&
      whole.size > 0 && [layout === "pcd" ? "Scans" : "Files", `${plural(whole.size, files)}, ${formatBytes(taken)}`],
    look.pose_frame && [
      "Poses",
      [POSE_OWNERS[look.pose_frame] ?? look.pose_frame, el("small.why", look.pose_frame_reason)],
    ],
    ["Georeference", georeferenceOf(drive)],
    maps.size > 0 && ["Maps", [...maps.keys()].join(", ")],
    ["To be sent", sent],
    unused.files > 0 && ["Not needed", `${plural(unused.files, "file")}, ${formatBytes(unused.bytes)}`],
  ];
}
