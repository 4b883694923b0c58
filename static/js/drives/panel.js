/** The drives of the server and their jobs: to come back to, to run again, to delete; and the demo. */
import { sendJson } from "../api.js";
import { iconButton } from "../controls.js";
import { demo, demoText, onDemoChange, tryDemo } from "../data/demo.js";
import { lists, onListsChange, refreshLists, refreshOldLists, rememberDrive, titleOf } from "../data/lists.js";
import { el, fill, formatAgo, formatBytes, formatCount, formatMetres, groupBy, icon, plural } from "../dom.js";
import { rename } from "../job/naming.js";
import { openRunDialog } from "../job/run_dialog.js";
import {
  ANYONE,
  afterDeletion,
  driveBadge,
  openDrive,
  openJob,
  outcomeOf,
  standing,
  stateBadge,
} from "../job/words.js";
import { confirmAction, problemNote, retryNote, showError } from "../messages.js";
import { getState, setState, subscribe } from "../state.js";
import { liveSection } from "./live.js";
import { trashSection } from "./trash.js";

const ROOM = 50; // cards at first, and more each time
const FEW = 10; // drives that need no search

/** @param {HTMLElement} container */
export function mount(container) {
  const trouble = el("div");
  const button = el("button", { onClick: () => void tryDemo() }, "Try the demo");
  const open = () => setState({ panel: "upload" });
  const upload = el("button.primary", { onClick: open }, icon("upload"), "Upload a drive");
  const body = el("div.stack-s", el("p.quiet", "Loading…"));
  let room = ROOM;
  const words = { placeholder: "Find a drive", "aria-label": "Find drives by name, note or owner" };
  const search = el("input", { type: "search", ...words, onInput: () => ((room = ROOM), update()) });
  const status = el("p.small", { role: "status" });
  const find = el("div.stack-s", { hidden: true }, search, status);
  const buttons = el("div.row", upload, button);
  fill(container, el("div.stack", buttons, trouble, liveSection(), find, body, trashSection()));

  const showDemo = () => {
    button.disabled = demo.isRunning;
    if (demo.error !== null) fill(trouble, problemNote(demo.error));
    else if (demo.isRunning) {
      const bar = el("progress", { max: 1, value: demo.fraction, "aria-label": "Progress of the demo" });
      fill(trouble, el("div.note.stack-s", el("strong", "Preparing the demo"), demoText(), bar));
    } else fill(trouble);
  };
  onDemoChange(showDemo);
  showDemo();

  const update = () => {
    if (!lists.isLoaded) return;
    const found = drivesCalled(search.value);
    const current = getState().drive;
    const cards = found.filter(({ id }, i) => i < room || id === current);
    const jobs = groupBy(lists.jobs, (job) => job.drive_id);
    buttons.hidden = !lists.drives.length; // the map has them then
    find.hidden = lists.drives.length <= FEW && !search.value;
    const all = `${lists.isCut ? "the newest " : ""}${plural(lists.drives.length, "drive")}`;
    fill(status, search.value.trim() || lists.isCut ? `${formatCount(found.length)} of ${all}` : "");
    fill(
      body,
      lists.drives.length ? cards.map((drive) => driveCard(drive, jobs.get(drive.id) ?? [])) : emptyNote(),
      found.length > room && el("button", { onClick: showMore }, `Show more (${formatCount(found.length - room)})`),
    );
  };
  const showMore = () => {
    const at = room;
    room += ROOM;
    update();
    /** @type {HTMLElement|null} */ (body.children[at]?.querySelector("h3 button"))?.focus();
  };
  onListsChange(update);
  subscribe(["drive", "job"], update);
  const look = (refresh = refreshOldLists) =>
    refresh().catch((error) => {
      if (lists.isLoaded) return showError(error);
      const note = retryNote(error, () => look(refreshLists));
      fill(body, note);
    });
  subscribe(["panel"], ({ panel }) => panel === "drives" && look());
  void look(); // they may have been loaded for another panel, some time ago
  update();
}

function emptyNote() {
  const text =
    "A drive is the scans of a LiDAR along a road: SemanticKITTI, KITTI raw, KITTI-360, PCD files, a ROS bag or LAS. " +
    "Poses, labels and GNSS in it are used; what is missing is made from the points. The demo shows what comes out.";
  return el("div.empty.quiet", el("h3", "No drive yet"), el("p", text));
}

/** @param {string} words @returns {any[]} The drives that have them in their name, note or owner. */
function drivesCalled(words) {
  const text = words.trim().toLowerCase();
  if (!text) return lists.drives;
  return lists.drives.filter(
    ({ id, name, note, owner }) =>
      [name, note ?? "", owner].some((each) => each.toLowerCase().includes(text)) || id === text,
  );
}

/** @param {any} drive @param {any[]} jobs Its own. */
function driveCard(drive, jobs) {
  const current = getState().drive === drive.id;
  const hasSeveral = jobs.filter(({ state }) => state === "successful").length > 1;
  const facts = [];
  if (drive.scans) facts.push(plural(drive.scans, "scan"));
  else if (drive.files && drive.state !== "ready") facts.push(plural(drive.files, "file"));
  if (drive.length_m) facts.push(formatMetres(drive.length_m, 0));
  const bytes = drive.stored_bytes || drive.size_bytes;
  if (bytes) facts.push(formatBytes(bytes));
  facts.push(formatAgo(drive.created_at));
  if (drive.owner !== ANYONE) facts.push(`by ${drive.owner}`);
  if (drive.state === "ready" && !drive.bbox) facts.push("no georeference");
  const open = () =>
    drive.state === "uploading" ? setState({ drive: drive.id, job: null, panel: "upload" }) : openDrive(drive.id);
  const run = () => openRunDialog(drive.id).catch(showError);
  const edit = rename(`drives/${drive.id}`, drive, drive.name, (changed) => {
    rememberDrive(changed);
    refreshLists().catch(showError); // jobs tell the name of their drive
  });
  const text = el("div", [
    el("p.small", facts.join(" · ")),
    drive.note && el("p.small.noted", drive.note),
    drive.state !== "ready" && el("p", driveBadge(drive)),
  ]);
  return el("article", { class: `drive${current ? " is" : ""}` }, [
    el("header.spread", [
      el("h3.grow", el("button.link.cut", { title: drive.name, onClick: open }, drive.name)),
      drive.state === "ready" && iconButton("run", `Run ${drive.name}`, run, "Run it with other settings"),
      edit,
      iconButton("trash", `Delete ${drive.name}`, () => removeDrive(drive).catch(showError), "Delete the drive"),
      text,
    ]),
    jobs.length > 0 && el("ul.jobs", [jobs.map((each) => jobRow(each, hasSeveral))]),
  ]);
}

const STANDS = { pinned: "Shown for the drive: pinned", best: "Shown for the drive: the best of its jobs" };

/** @param {any} job @param {boolean} isOneOf Whether the drive has several results. */
function jobRow(job, isOneOf) {
  const isDone = job.state === "successful";
  const why = isOneOf && standing(job);
  const byWhat = "By intersections right and nodes found together: F1";
  const button = el("button", { "aria-current": String(getState().job === job.id), onClick: () => openJob(job) }, [
    el("span.cut", { title: titleOf(job) }, titleOf(job)),
    isDone ? el("span.small", formatAgo(job.finished_at)) : stateBadge(job.state),
    isDone && el("span.small.both", outcomeOf(job)),
    why && el("span.small.both.stands", { title: byWhat }, STANDS[why]),
  ]);
  return el("li", button);
}

/** @param {any} drive */
async function removeDrive(drive) {
  const text = `Its scans, jobs and results go with it. ${afterDeletion()}`;
  if (!(await confirmAction(`Delete ${drive.name}?`, text, "Delete the drive"))) return;
  await sendJson("DELETE", `drives/${drive.id}`);
  if (getState().drive === drive.id) setState({ drive: null, job: null, frame: null, view: null, panel: "drives" });
  await refreshLists();
}
