/** The form between picking a folder and sending it: what was found, how to read it, what to do with it. */

import { ApiError, getConfig, isMap, sendJson } from "../api.js";
import { factRows, field, filePicker, problemList, radios, section, select } from "../controls.js";
import { el, fill, formatBytes, formatCount, formatPercent, icon, plural } from "../dom.js";
import {
  checkDrive,
  error,
  LABEL_FOLDERS,
  LAYOUTS,
  layoutOf,
  numberedFiles,
  oxtsRows,
  sampleOf,
  sorted,
} from "./drive_folder.js";
import { folderOfInput } from "./folder.js";
import { jobForm } from "./job_form.js";
import { fingerprintOf } from "./memory.js";
import { countFolders, groundBytesOf } from "./upload.js";

/** @typedef {import("./drive_folder.js").DriveFolder} DriveFolder */
/** @typedef {import("../api.js").FileProblem} FileProblem */
/** @typedef {import("./upload.js").JudgedLabels} JudgedLabels */
/** @typedef {import("./upload.js").Settings} Settings */

const ADDED = /^(poses|cam0_to_world|times|calib[^/]*)\.txt$|^geo\.csv$/;

const POSE_FRAMES = {
  auto: "From the motion",
  camera: "Camera (KITTI, SemanticKITTI)",
  lidar: "LiDAR (kiss-icp and others)",
};

const SENDING = {
  keyframes: ["What the method needs", "The ground points of keyframes: the smallest, with the same results."],
  scans: ["Ground points of every scan", "For jobs with denser keyframes later on."],
  raw: ["Everything as it is", "All scans whole; the service reduces them after it has checked them."],
};

/**
 * @param {object} picked
 * @param {DriveFolder | null} picked.drive
 * @param {DriveFolder[]} picked.drives All in the folder.
 * @param {File | null} picked.archive
 * @param {FileSystemDirectoryHandle | null} picked.handle
 * @param {any} picked.presets
 * @param {import("./memory.js").Remembered | null} picked.begun The upload of the same folder that was begun before.
 * @param {Settings | null} picked.before Settings to start from.
 * @param {object} actions
 * @param {(source: import("./upload.js").Source, settings: Settings) => void} actions.onStart
 * @param {() => void} actions.onBack
 * @param {(drive: DriveFolder) => void} actions.onChoose Another drive of the folder.
 * @param {(begun: import("./memory.js").Remembered) => void} actions.onContinue
 */
export function formView(
  { drive, drives, archive, handle, presets, begun, before },
  { onStart, onBack, onChoose, onContinue },
) {
  const value = before?.name ?? drive?.name ?? baseName(archive);
  const name = el("input", { type: "text", required: true, maxLength: 200, value, onInput: refresh });
  const facts = el("dl", { class: "figures" });
  const problems = el("div", { "aria-live": "polite" });
  const added = el("span", { class: "small", role: "status" });
  const isReduced = drive?.layout === "reduced";
  const isOpen = drive !== null && !isReduced; // not sent as it is: there are a scheme and folders to choose
  const canReduce = typeof CompressionStream === "function" && typeof Worker === "function";

  const labels = labelSection(before, !drive, { onChange: () => (judge(), refresh()), onFolder: addPredictions });
  const reading = readingSection(before, refresh);
  const usual = canReduce ? (before?.sending ?? "keyframes") : "raw";
  const keepRaw = el("input", { type: "checkbox", checked: before?.keepRaw ?? false });
  const keep = el("label", { class: "check" }, keepRaw, el("span", {}, "Let the service keep the whole scans"));
  const choices = Object.entries(SENDING).filter(([value]) => canReduce || value === "raw");
  const sending = radios(
    "What is sent",
    choices.map(([value, [title, hint]]) => ({ value, title, hint, more: value === "raw" ? keep : null })),
    usual,
    refresh,
  );
  const known = {
    maps: drive ? [...drive.maps.keys()] : [],
    isArchive: !drive,
    folders: drive ? labelNames(drive) : [],
    hasGeoreference: Boolean(drive && hasFix(drive)),
    presets,
    before: before?.job ?? null,
  };
  const job = jobForm(known, refresh);

  /** @type {JudgedLabels[]} */
  let judged = [];
  /** @type {FileProblem[]} */
  let labelProblems = [];
  let asked = 0;
  /** Count the label ids of some scans, and let the service judge what they mean. */
  async function judge() {
    if (!drive || !isOpen) return;
    asked += 1;
    const mine = asked;
    const frames = sampleOf([...(drive.scans?.files.keys() ?? [])]);
    try {
      const label_counts = await countFolders(drive, labels.folders(), frames);
      const options = { ...reading.read(), label_scheme: labels.scheme() };
      if (options.layout === "auto") options.layout = drive.layout;
      const answer = await sendJson("POST", "drives/labels", { label_counts, options });
      if (mine !== asked) return; // asked again meanwhile
      judged = answer.labels;
      labelProblems = judged.flatMap((each) => each.problems);
    } catch (fault) {
      if (mine !== asked) return;
      judged = [];
      const refused = fault instanceof ApiError ? fault.problems[0]?.message.replace("Value error, ", "") : null;
      labelProblems = [error("labels", refused ?? (fault instanceof Error ? fault.message : String(fault)))];
    }
    labels.setVerdict(judged);
    refresh();
  }

  /** @param {FileList} list */
  function addPredictions(list) {
    if (!drive) return;
    const folder = folderOfInput(list);
    const found = [...folder.files].filter(([path]) => path.endsWith(".label"));
    const places = [...new Set(found.map(([path]) => path.slice(0, path.lastIndexOf("/") + 1)))];
    const place = places.length > 1 ? places.find((path) => path.split("/").includes(drive.name)) : places[0];
    if (place === undefined) {
      const several = `holds labels of several drives; none of them is named ${drive.name}`;
      added.textContent = `${folder.name} ${places.length ? several : "holds no .label file"}.`;
      return;
    }
    const own = found.filter(([path]) => path.startsWith(place));
    const files = new Map(own.map(([path, file]) => [path.slice(place.length), file]));
    /** @type {FileProblem[]} */
    const faults = [];
    const numbered = numberedFiles(files, "predictions", ".label", faults);
    added.textContent = faults[0] ? `${faults[0].path} ${faults[0].message}` : "";
    if (!numbered || faults.length) return;
    drive.labels.predictions = numbered;
    update();
  }

  /** @param {FileList} list */
  async function addFiles(list) {
    if (!drive) return;
    const refused = [];
    for (const file of list) {
      if (isMap(file.name)) refused.push(`${file.name}: choose it under Map.`);
      else if (ADDED.test(file.name)) drive.small.set(file.name, file);
      else if (/^\d\d\.txt$/.test(file.name)) drive.small.set("poses.txt", file);
      else refused.push(`${file.name}: expected poses.txt, calib*.txt, times.txt or geo.csv.`);
    }
    drive.layout = await layoutOf(drive);
    added.textContent = refused.join(" ");
    update();
  }

  /** After files came or went. */
  function update() {
    if (drive) {
      labels.setFolders(drive.labels);
      judge();
    }
    refresh();
  }

  function refresh() {
    const fix = reading.georeference();
    const folders = isOpen ? labels.folders() : [];
    if (drive) {
      job.setFolders(isReduced ? labelNames(drive) : folders);
      job.setGeoreference(hasFix(drive) || fix !== null);
      fill(facts, factRows(factsOf(drive, folders, groundBytesOf(drive, judged), sending.value())));
    } else if (archive) {
      const size = /** @type {[string, string]} */ (["Size", formatBytes(archive.size)]);
      fill(facts, factRows([["Archive", archive.name], size]));
    }
    const list = drive ? sorted([...checkDrive(drive, folders, fix !== null), ...labelProblems]) : [];
    fill(
      problems,
      problemList(list),
      drive?.borrowed.map((text) => el("p", { class: "small" }, text)),
    );
    const complaint = list.some(({ severity }) => severity === "error")
      ? "Correct what is listed as an error first: the service would refuse the drive."
      : !name.value.trim()
        ? "Give the drive a name."
        : (job.complaint() ?? reading.complaint() ?? (isOpen && !folders.length ? "Choose a folder of labels." : null));
    run.disabled = only.disabled = complaint !== null;
    why.textContent = complaint ?? "";
  }

  /** @param {boolean} withJob */
  function start(withJob) {
    const { job: request, map } = job.read();
    const fix = reading.georeference();
    const oxts = fix && `georeference/${fix.name}`;
    const extras = new Map();
    if (map) extras.set(map.name, map);
    if (fix) extras.set(oxts, fix);
    const own = request.osm && "file" in request.osm ? drive?.maps.get(request.osm.file) : null;
    if (own) extras.set(/** @type {{file: string}} */ (request.osm).file, own);
    const isRaw = sending.value() === "raw";
    onStart(
      { drive, archive, extras, handle, fingerprint: drive ? fingerprintOfDrive(drive) : "" },
      {
        name: name.value.trim(),
        folders: isOpen ? labels.folders() : [],
        sending: isReduced ? "raw" : /** @type {any} */ (sending.value()),
        keepRaw: isRaw && keepRaw.checked,
        options: { label_scheme: labels.scheme(), ...reading.read(), oxts },
        keyframes: job.keyframes(),
        job: withJob ? request : null,
      },
    );
  }

  const run = el("button", { class: "primary grow", onClick: () => start(true) }, icon("run"), "Upload and run");
  const only = el("button", { onClick: () => start(false) }, "Upload only");
  const why = el("small", { role: "status" });
  const files = filePicker("Add files …", addFiles, {
    multiple: true,
    accept: ".txt,.csv",
    class: "link",
    name: "more-files",
  });
  const howToRead = el("div", { class: "stack-s" }, !drive && labels.element, reading.element);
  const other = el("button", { class: "plain", onClick: onBack }, "Choose another");
  const element = el(
    "div",
    { class: "stack upload-form" },
    el("div", { class: "spread" }, el("h2", {}, "What to upload"), other),
    begun && resumeNote(() => onContinue(begun)),
    drive && drives.length > 1 && driveChooser(drive, drives, onChoose),
    el(
      "div",
      { class: "box stack-s" },
      facts,
      isOpen && el("div", {}, files, " ", el("small", {}, "poses, calibration, times, geo.csv")),
      added,
    ),
    problems,
    field("Name", name, "Shown in lists and results."),
    isOpen && labels.element,
    job.element,
    !isReduced && el("details", {}, el("summary", {}, "How the files are read"), howToRead),
    isOpen && el("details", { open: usual !== "keyframes" }, el("summary", {}, "What is sent"), sending.element),
    el("div", { class: "stack-s foot" }, why, el("div", { class: "row" }, run, only)),
  );
  update();
  return element;
}

/** @param {() => void} onContinue */
function resumeNote(onContinue) {
  const button = el("button", { class: "primary", onClick: onContinue }, "Continue that upload");
  const title = el("strong", {}, "You began to upload this folder");
  const text = "What has arrived already is not sent again. ";
  return el("div", { class: "note" }, title, text, el("div", { class: "row go-on" }, button));
}

/** @param {DriveFolder} drive @param {DriveFolder[]} drives @param {(drive: DriveFolder) => void} onChoose */
function driveChooser(drive, drives, onChoose) {
  const text = (/** @type {DriveFolder} */ { root, name, scans, ground }) =>
    `${root || name} (${plural(scans?.files.size ?? ground.size, "scan")})`;
  const options = Object.fromEntries(drives.map((each, i) => [String(i), text(each)]));
  const choice = select(options, String(drives.indexOf(drive)), (i) => onChoose(drives[Number(i)]));
  return field(`${drives.length} drives are in the folder: which one?`, choice);
}

/** @param {DriveFolder} drive */
export function fingerprintOfDrive(drive) {
  const numbered = [drive.scans, ...Object.values(drive.labels)].filter((each) => each !== null);
  /** @type {[string, File][]} */
  const files = [...drive.small, ...drive.ground];
  for (const { folder, files: own } of numbered)
    for (const [number, file] of own) files.push([`${folder}/${number}`, file]);
  return fingerprintOf(files);
}

/** @param {DriveFolder} drive */
function hasFix({ small }) {
  return small.has("geo.csv") || [...small.keys()].some((path) => /^(oxts|georeference)\//.test(path));
}

/** @param {DriveFolder} drive */
function labelNames(drive) {
  if (drive.layout !== "reduced") return Object.keys(drive.labels);
  return [...new Set([...drive.ground.keys()].map((path) => path.split("/")[1]))].sort();
}

/** @param {File | null} archive */
const baseName = (archive) => archive?.name.replace(/\.(zip|tgz|tzst|tar(\.\w+)?)$/i, "") ?? "";

/**
 * @param {DriveFolder} drive
 * @param {string[]} folders
 * @param {number} groundBytes What is left of a scan.
 * @param {string} sending
 * @returns {Parameters<typeof factRows>[0]}
 */
function factsOf(drive, folders, groundBytes, sending) {
  const { scans, labels, ground, maps, unused, small, layout } = drive;
  const numbers = [...(scans?.files.keys() ?? [])];
  const labelBytes = folders.reduce((sum, folder) => sum + (labels[folder]?.bytes ?? 0), 0);
  const packed = [...ground.values()].reduce((sum, file) => sum + file.size, 0);
  const whole = formatBytes(scans ? scans.bytes + labelBytes : packed);
  const part = `${formatBytes(scans ? groundBytes * scans.files.size : packed)} of ${whole}`;
  const sent = { keyframes: `at most about ${part}`, scans: `about ${part}` }[sending] ?? whole;
  return [
    ["Layout", LAYOUTS[layout]],
    scans && ["Scans", `${plural(numbers.length, "scan")}, ${numbers[0]} to ${numbers.at(-1)}`],
    scans && ["Points", `about ${formatCount(scans.bytes / 16 / numbers.length)} per scan`],
    ground.size > 0 && ["Files of ground points", formatCount(ground.size)],
    ["Georeference", hasFix(drive) ? (small.has("geo.csv") ? "geo.csv" : "oxts/") : "none in the folder"],
    maps.size > 0 && ["Maps", [...maps.keys()].join(", ")],
    ["To be sent", layout === "reduced" ? formatBytes(packed) : sent],
    unused.files > 0 && ["Not needed", `${plural(unused.files, "file")}, ${formatBytes(unused.bytes)}`],
  ];
}

/**
 * Which label folders are sent, and what their ids mean.
 *
 * @param {Settings | null} before
 * @param {boolean} isUnknown The folders are not known yet, as those of an archive.
 * @param {{onChange: () => void, onFolder: (files: FileList) => void}} listeners `onFolder`: predictions from elsewhere.
 */
function labelSection(before, isUnknown, { onChange, onFolder }) {
  const rows = el("div", { class: "stack-s" });
  /** @type {Map<string, HTMLInputElement>} */
  const boxes = new Map();
  const schemes = getConfig().label_schemes.map(({ name, title, road }) => [
    name,
    `${title} (road = ${road.join(", ")})`,
  ]);
  const choices = { auto: "From the ids", ...Object.fromEntries(schemes), custom: "My own ids of road …" };
  const chosen = before?.options.label_scheme ?? "auto";
  const isCustom = !(chosen in choices);
  const ids = el("input", { type: "text", placeholder: "40, 60", value: isCustom ? chosen : "", onInput: onChange });
  ids.setAttribute("aria-label", "Ids of road");
  ids.hidden = !isCustom;
  const scheme = select(choices, isCustom ? "custom" : chosen, (value) => {
    ids.hidden = value !== "custom";
    onChange();
  });
  const verdict = el("small", {});
  const elsewhere = { folder: true, class: "link", name: "prediction-folder" };
  const picker = filePicker("Predictions from another folder …", onFolder, elsewhere);
  const meaning = el("div", { class: "stack-s" }, field("What their ids mean", scheme), ids, verdict);

  return {
    element: section("Labels", !isUnknown && [rows, el("div", {}, picker)], meaning),

    /** @param {DriveFolder["labels"]} folders */
    setFolders(folders) {
      const names = Object.keys(folders);
      const wasOff = new Set([...boxes].filter(([, box]) => !box.checked).map(([name]) => name));
      boxes.clear();
      const items = names.map((name) => {
        const isOn = before ? before.folders.includes(name) || !boxes.size : !wasOff.has(name);
        const isOnly = names.length === 1;
        const box = el("input", { type: "checkbox", checked: isOn || isOnly, disabled: isOnly, onChange });
        boxes.set(name, box);
        const count = plural(folders[name].files.size, "file");
        if (isOnly) return el("p", {}, `${LABEL_FOLDERS[name]}, ${count}`);
        return el("label", { class: "check" }, box, el("span", {}, LABEL_FOLDERS[name], el("small", {}, count)));
      });
      fill(rows, items, !names.length && el("p", { class: "quiet" }, "None in the folder."));
    },

    folders: () => [...boxes].filter(([, box]) => box.checked).map(([name]) => name),
    scheme: () => (scheme.value === "custom" ? ids.value.trim() || "custom" : scheme.value),

    /** @param {JudgedLabels[]} judged */
    setVerdict(judged) {
      const found = judged.filter((each) => each.scheme !== null);
      const text = (/** @type {JudgedLabels} */ { folder, scheme: name, road_share }) =>
        `${folder}: read as ${name === "custom" ? "given" : name}, ${formatPercent(road_share)} road.`;
      verdict.textContent = found.map(text).join(" ");
    },
  };
}

/**
 * How the files are read: poses, layout, georeference from elsewhere.
 *
 * @param {Settings | null} before
 * @param {() => void} onChange
 */
function readingSection(before, onChange) {
  /** @type {File | null} */
  let fix = null;
  const status = el("span", { class: "small quiet" }, "None chosen yet");
  /** @param {Promise<File> | File} picked */
  async function take(picked) {
    fix = null;
    try {
      const file = await picked;
      if (!/\.(txt|csv)(\.gz)?$/i.test(file.name)) {
        throw new Error(`${file.name}: expected a file of OXTS rows (.txt, .txt.gz) or a geo.csv.`);
      }
      fix = file;
      status.textContent = file.name;
    } catch (error) {
      status.textContent = error instanceof Error ? error.message : String(error);
    }
    onChange();
  }
  const progress = (/** @type {number} */ done, /** @type {number} */ total) =>
    (status.textContent = `Reading ${formatCount(done)} of ${formatCount(total)} fixes`);
  const asFile = filePicker("A file …", ([file]) => take(file), {
    accept: ".txt,.csv,.gz",
    name: "georeference-file",
  });
  const asFolder = filePicker("A KITTI raw drive …", (list) => take(oxtsRows(folderOfInput(list), progress)), {
    folder: true,
    name: "raw-drive",
  });
  const pickers = el("div", { class: "stack-s" }, el("div", { class: "row" }, asFile, asFolder), status);
  const ofDrive = "oxts/ or geo.csv; without them, local metres only.";
  const ofOthers = "One row of OXTS per frame, a geo.csv, or the KITTI raw drive of an odometry sequence.";
  const source = radios(
    "Georeference",
    [
      { value: "drive", title: "From the folder", hint: ofDrive },
      { value: "other", title: "From elsewhere", hint: ofOthers, more: pickers },
    ],
    "drive",
    onChange,
  );
  const poseFrame = select(POSE_FRAMES, before?.options.pose_frame ?? "auto", onChange);
  const { reduced: _, ...layouts } = LAYOUTS;
  const layout = select({ auto: "From the folder", ...layouts }, before?.options.layout ?? "auto", onChange);
  const poses = field("Poses are those of", poseFrame, "A wrong choice is noticed: the road would not be flat.");
  const grid = el("div", { class: "grid-2" }, poses, field("Layout", layout));
  const isMissing = () => source.value() === "other" && !fix;

  return {
    element: el("div", { class: "stack-s" }, source.element, grid),
    read: () => ({ pose_frame: poseFrame.value, layout: layout.value }),
    georeference: () => (source.value() === "other" ? fix : null),
    /** @returns {string | null} */
    complaint: () => (isMissing() ? "Choose the georeference from elsewhere, or use that of the folder." : null),
  };
}
