/** The form between picking a folder and sending it: what was found, how to read it, what to do with it. */

import { el, fill, formatBytes, icon, plural } from "../dom.js";
import { checkDrive } from "./checks.js";
import { field, filePicker, problemList, radios, select } from "./controls.js";
import { layoutOf, OSM_FILE } from "./drive_folder.js";
import { folderOfInput } from "./folder.js";
import { jobForm } from "./job_form.js";
import { labelSection } from "./label_section.js";
import { fingerprintOf } from "./memory.js";
import { error, numberedFiles, sorted } from "./numbered.js";
import { placeOf } from "./oxts_rows.js";
import { readingSection } from "./reading_section.js";
import { groundBytesOf, judgeLabels, sampleOf } from "./schemes.js";
import { LAYOUTS, SENDING } from "./words.js";

/** @typedef {import("./drive_folder.js").DriveFolder} DriveFolder */

const ADDED = /^(poses|cam0_to_world|times|calib[^/]*)\.txt$|^geo\.csv$/;

/**
 * @param {object} picked
 * @param {DriveFolder | null} picked.drive
 * @param {DriveFolder[]} picked.drives All in the folder.
 * @param {File | null} picked.archive
 * @param {FileSystemDirectoryHandle | null} picked.handle
 * @param {any} picked.presets
 * @param {import("./memory.js").Remembered | null} picked.begun The upload of the same folder that was begun before.
 * @param {import("./upload.js").Settings | null} picked.before Settings to start from.
 * @param {object} actions
 * @param {(source: import("./upload.js").Source, settings: import("./upload.js").Settings) => void} actions.onStart
 * @param {() => void} actions.onBack
 * @param {(drive: DriveFolder) => void} actions.onChoose Another drive of the folder.
 * @param {(begun: import("./memory.js").Remembered) => void} actions.onContinue
 */
export function formView(
  { drive, drives, archive, handle, presets, begun, before },
  { onStart, onBack, onChoose, onContinue },
) {
  const name = el("input", {
    type: "text",
    required: true,
    maxLength: 200,
    value: before?.name ?? drive?.name ?? baseName(archive),
    onInput: refresh,
  });
  const facts = el("dl", { class: "figures" });
  const problems = el("div", { "aria-live": "polite" });
  const foot = el("div", { class: "stack-s foot" });
  const added = el("span", { class: "small", role: "status" });
  const isWhole = !drive || drive.layout === "reduced"; // sent as it is; no scheme or folders to choose
  const canReduce = typeof CompressionStream === "function" && typeof Worker === "function";

  const labels = labelSection(before, !drive, { onChange: () => (judge(), refresh()), onFolder: addPredictions });
  const reading = readingSection(before, refresh);
  const usual = canReduce ? (before?.sending ?? "keyframes") : "raw";
  const keepRaw = el("input", { type: "checkbox", checked: before?.keepRaw ?? false });
  const keep = el("label", { class: "check" }, keepRaw, el("span", {}, "Let the service keep the whole scans"));
  const sending = radios(
    "What is sent",
    Object.entries(SENDING)
      .filter(([value]) => canReduce || value === "raw")
      .map(([value, [title, hint]]) => ({ value, title, hint, more: value === "raw" ? keep : null })),
    usual,
    refresh,
  );
  const job = jobForm(
    {
      maps: drive ? [...drive.maps.keys()] : [],
      isArchive: !drive,
      folders: drive ? labelNames(drive) : [],
      hasGeoreference: Boolean(drive && hasFix(drive)),
      presets,
      before: before?.job ?? null,
    },
    refresh,
  );

  /** @type {import("./schemes.js").Judgement[]} */
  let judged = [];
  /** @type {import("./numbered.js").FileProblem[]} */
  let labelProblems = [];
  let judging = 0;
  async function judge() {
    if (!drive || isWhole) return;
    judging += 1;
    const turn = judging;
    const frames = sampleOf([...(drive.scans?.files.keys() ?? [])]);
    const layout = reading.read().layout;
    const isKitti360 = layout === "kitti360" || (layout === "auto" && drive.layout === "kitti360");
    /** @type {[string, import("./schemes.js").Judgement][]} */
    const found = [];
    /** @type {import("./numbered.js").FileProblem[]} */
    const faults = [];
    for (const folder of labels.folders()) {
      try {
        found.push([folder, await judgeLabels(drive.labels[folder], frames, labels.scheme(), isKitti360)]);
      } catch (fault) {
        faults.push(error(folder, fault instanceof Error ? fault.message : String(fault)));
      }
    }
    if (turn !== judging) return; // asked again meanwhile
    judged = found.map(([, each]) => each);
    labelProblems = [...judged.flatMap((each) => each.problems), ...faults];
    labels.setVerdict(found);
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
      const text = places.length
        ? `${folder.name} holds labels of several drives; none of them is named ${drive.name}.`
        : `${folder.name} holds no .label file.`;
      added.textContent = text;
      return;
    }
    const files = new Map(
      found.filter(([path]) => path.startsWith(place)).map(([path, file]) => [path.slice(place.length), file]),
    );
    /** @type {import("./numbered.js").FileProblem[]} */
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
      if (OSM_FILE.test(file.name)) refused.push(`${file.name}: choose it under Map.`);
      else if (ADDED.test(file.name)) drive.small.set(file.name, file);
      else if (/^\d\d\.txt$/.test(file.name)) drive.small.set("poses.txt", file);
      else refused.push(`${file.name}: is none of poses.txt, calib*.txt, times.txt, geo.csv.`);
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
    if (drive) {
      job.setFolders(isWhole ? labelNames(drive) : labels.folders());
      job.setGeoreference(hasFix(drive) || fix !== null);
      fill(
        facts,
        factsOf(
          drive,
          isWhole ? [] : labels.folders(),
          groundBytesOf(drive, judged),
          /** @type {any} */ (sending.value()),
        ),
      );
    } else if (archive) {
      fill(facts, fact("Archive", archive.name), fact("Size", formatBytes(archive.size)));
    }
    const list = drive
      ? sorted([...checkDrive(drive, isWhole ? [] : labels.folders(), fix !== null), ...labelProblems])
      : [];
    fill(
      problems,
      problemList(list),
      drive?.borrowed.map((text) => el("p", { class: "small" }, text)),
    );
    const complaint = list.some(({ severity }) => severity === "error")
      ? "Mend what is listed as an error first: the service would refuse the drive."
      : !name.value.trim()
        ? "Give the drive a name."
        : (job.complaint() ??
          reading.complaint() ??
          (drive && !isWhole && !labels.folders().length ? "Choose a folder of labels." : null));
    run.disabled = only.disabled = complaint !== null;
    why.textContent = complaint ?? "";
  }

  /** @param {boolean} withJob */
  function start(withJob) {
    const { job: request, map } = job.read();
    const fix = reading.georeference();
    const extras = new Map();
    if (map) extras.set(map.name, map);
    if (fix) extras.set(placeOf(fix.name), fix);
    if (drive && request.osm && "file" in request.osm && drive.maps.has(request.osm.file)) {
      extras.set(request.osm.file, drive.maps.get(request.osm.file));
    }
    onStart(
      { drive, archive, extras, handle, fingerprint: drive ? fingerprintOfDrive(drive) : "" },
      {
        name: name.value.trim(),
        folders: drive && !isWhole ? labels.folders() : [],
        sending: drive?.layout === "reduced" ? "raw" : /** @type {any} */ (sending.value()),
        keepRaw: sending.value() === "raw" && keepRaw.checked,
        options: { label_scheme: labels.scheme(), ...reading.read(), oxts: fix && placeOf(fix.name) },
        keyframes: job.keyframes(),
        job: withJob ? request : null,
      },
    );
  }

  const run = el("button", { class: "primary grow", onClick: () => start(true) }, icon("run"), "Upload and run");
  const only = el("button", { onClick: () => start(false) }, "Upload only");
  const why = el("small", { role: "status" });
  fill(foot, why, el("div", { class: "row" }, run, only));

  const chooser =
    drives.length > 1 &&
    field(
      `${drives.length} drives are in the folder: which one?`,
      select(
        Object.fromEntries(
          drives.map((each, i) => [
            String(i),
            `${each.root || each.name} (${plural(each.scans?.files.size ?? each.ground.size, "scan")})`,
          ]),
        ),
        String(drives.indexOf(/** @type {DriveFolder} */ (drive))),
        (i) => onChoose(drives[Number(i)]),
      ),
    );
  const resume =
    begun &&
    el(
      "div",
      { class: "note" },
      el("strong", {}, "You began to upload this folder"),
      "What has arrived already is not sent again. ",
      el(
        "div",
        { class: "row go-on" },
        el("button", { class: "primary", onClick: () => onContinue(begun) }, "Continue that upload"),
      ),
    );
  const files = filePicker("Add files …", addFiles, {
    multiple: true,
    accept: ".txt,.csv",
    class: "link",
    name: "more-files",
  });
  const element = el(
    "div",
    { class: "stack upload-form" },
    el(
      "div",
      { class: "spread" },
      el("h2", {}, "What to upload"),
      el("button", { class: "plain", onClick: onBack }, "Choose another"),
    ),
    resume,
    chooser,
    el(
      "div",
      { class: "box stack-s" },
      facts,
      drive && !isWhole && el("div", {}, files, " ", el("small", {}, "poses, calibration, times, geo.csv")),
      added,
    ),
    problems,
    field("Name", name, "Shown in lists and results."),
    drive && !isWhole && labels.element,
    job.element,
    !(drive?.layout === "reduced") &&
      el(
        "details",
        {},
        el("summary", {}, "How the files are read"),
        el("div", { class: "stack-s" }, !drive && labels.element, reading.element),
      ),
    drive &&
      !isWhole &&
      el("details", { open: usual !== "keyframes" }, el("summary", {}, "What is sent"), sending.element),
    foot,
  );
  update();
  return element;
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
export function hasFix(drive) {
  return (
    drive.small.has("geo.csv") ||
    [...drive.small.keys()].some((path) => path.startsWith("oxts/") || path.startsWith("georeference/"))
  );
}

/** @param {DriveFolder} drive */
function labelNames(drive) {
  if (drive.layout !== "reduced") return Object.keys(drive.labels);
  return [...new Set([...drive.ground.keys()].map((path) => path.split("/")[1]))].sort();
}

/** @param {File | null} archive */
const baseName = (archive) => archive?.name.replace(/\.(zip|tgz|tzst|tar(\.\w+)?)$/i, "") ?? "";

/** @param {string} name @param {any} value */
const fact = (name, value) => [el("dt", {}, name), el("dd", {}, value)];

/**
 * @param {DriveFolder} drive
 * @param {string[]} folders
 * @param {number} groundBytes What is left of a scan.
 * @param {keyof typeof SENDING} sending
 */
function factsOf(drive, folders, groundBytes, sending) {
  const { scans, labels, ground, maps, unused } = drive;
  const numbers = [...(scans?.files.keys() ?? [])];
  const labelBytes = folders.reduce((sum, folder) => sum + (labels[folder]?.bytes ?? 0), 0);
  const packed = [...ground.values()].reduce((sum, file) => sum + file.size, 0);
  const reduced = scans ? groundBytes * scans.files.size : packed;
  const whole = scans ? scans.bytes + labelBytes : packed;
  const sent = {
    keyframes: `at most about ${formatBytes(reduced)} of ${formatBytes(whole)}`,
    scans: `about ${formatBytes(reduced)} of ${formatBytes(whole)}`,
    raw: formatBytes(whole),
  };
  return [
    fact("Layout", LAYOUTS[drive.layout]),
    scans && fact("Scans", `${plural(numbers.length, "scan")}, ${numbers[0]} to ${numbers.at(-1)}`),
    scans && fact("Points", `about ${Math.round(scans.bytes / 16 / numbers.length).toLocaleString("en")} a scan`),
    ground.size > 0 && fact("Files of ground points", ground.size.toLocaleString("en")),
    fact("Georeference", hasFix(drive) ? (drive.small.has("geo.csv") ? "geo.csv" : "oxts/") : "none in the folder"),
    maps.size > 0 && fact("Maps", [...maps.keys()].join(", ")),
    fact("To be sent", drive.layout === "reduced" ? formatBytes(packed) : sent[sending]),
    unused.files > 0 && fact("Not needed", `${plural(unused.files, "file")}, ${formatBytes(unused.bytes)}`),
  ];
}
