/**
 * The drives of the server and their jobs: to come back to, to run again, to delete.
 * @module drives/panel
 */
import { getJson, sendJson } from "../api.js";
import { lists, onListsChange, refreshLists } from "../data/lists.js";
import { el, fill, formatAgo, formatBytes, formatMetres, icon, plural } from "../dom.js";
import { openRunDialog } from "../job/run_dialog.js";
import { jobTitle, openDrive } from "../shell/header.js";
import { confirmAction, problemNote, showError } from "../shell/messages.js";
import { getState, setState, subscribe } from "../state.js";
import { runDemo } from "./demo.js";

const STATES = /** @type {Record<string, [string, string]>} */ ({
  uploading: ["Upload unfinished", ""],
  checking: ["Being checked", "busy"],
  ready: ["Ready", "good"],
  accepted: ["Waiting", "busy"],
  running: ["Running", "busy"],
  successful: ["Done", "good"],
  failed: ["Failed", "error"],
  dismissed: ["Cancelled", ""],
});

/** @param {string} state @returns {HTMLElement} */
export function stateBadge(state) {
  const [text, kind] = STATES[state] ?? [state, ""];
  return el("span", { class: `badge ${kind}` }, text);
}

/** @type {Map<string, any>} What the check of a drive found; lists leave it out. */
const reports = new Map();

/** @param {HTMLElement} container */
export function mount(container) {
  const trouble = el("div", {});
  const demo = el("button", { onClick: () => tryDemo() }, "Try the demo");
  const body = el("div", { class: "stack-s" });
  fill(
    container,
    el(
      "div",
      { class: "stack" },
      el(
        "div",
        { class: "row" },
        el(
          "button",
          { class: "primary", onClick: () => setState({ panel: "upload" }) },
          icon("upload"),
          "Upload a drive",
        ),
        demo,
      ),
      trouble,
      body,
    ),
  );

  const tryDemo = async () => {
    demo.disabled = true;
    fill(
      trouble,
      el(
        "div",
        { class: "note" },
        el("strong", {}, "Preparing the demo"),
        "The server drives through a small made-up town. Half a minute the first time.",
      ),
    );
    try {
      await runDemo();
      fill(trouble);
    } catch (error) {
      fill(trouble, problemNote(error));
    } finally {
      demo.disabled = false;
    }
  };

  const update = () => {
    if (!lists.isLoaded) return fill(body, el("p", { class: "quiet" }, "Loading…"));
    fill(body, lists.drives.length ? lists.drives.map(driveCard) : emptyNote());
    void learn();
  };
  const learn = async () => {
    const current = lists.drives.find((drive) => drive.id === getState().drive);
    if (current?.state !== "ready" || reports.has(current.id)) return;
    reports.set(current.id, null);
    reports.set(current.id, (await getJson(`drives/${current.id}`)).report);
    update();
  };
  onListsChange(update);
  subscribe(["drive", "job"], update);
  subscribe(["panel"], ({ panel }) => panel === "drives" && refreshLists().catch(showError));
  update();
}

function emptyNote() {
  return el(
    "div",
    { class: "empty quiet" },
    el("h3", {}, "No drive yet"),
    el(
      "p",
      {},
      "A drive is a folder of LiDAR scans with a label for every point, and poses: SemanticKITTI, KITTI raw, KITTI-360. The demo shows what comes out.",
    ),
  );
}

/** @param {any} drive */
function driveCard(drive) {
  const jobs = lists.jobs.filter((job) => job.drive_id === drive.id);
  const current = getState().drive === drive.id;
  const report = drive.report ?? reports.get(drive.id) ?? null;
  const facts = [];
  if (report?.scans) facts.push(plural(report.scans, "scan"));
  else if (drive.files) facts.push(plural(drive.files, "file"));
  if (report?.length_m) facts.push(formatMetres(report.length_m, 0));
  facts.push(formatBytes(drive.stored_bytes || drive.size_bytes), formatAgo(drive.created_at));
  return el(
    "article",
    { class: `drive${current ? " is" : ""}` },
    el(
      "header",
      {},
      el(
        "div",
        { class: "grow" },
        el(
          "h3",
          {},
          el(
            "button",
            {
              class: "link",
              title: drive.name,
              onClick: () =>
                drive.state === "uploading"
                  ? setState({ drive: drive.id, job: null, panel: "upload" })
                  : openDrive(drive.id),
            },
            drive.name,
          ),
        ),
        el("p", { class: "small cut" }, facts.join(" · ")),
        drive.state !== "ready" && el("p", {}, stateBadge(drive.state)),
        current &&
          report &&
          el(
            "p",
            { class: "small" },
            report.georeference ? `Georeference: ${report.georeference}` : "No georeference: metres of its own frame",
          ),
      ),
      drive.state === "ready" &&
        el(
          "button",
          {
            class: "square plain",
            title: "Run it with other settings",
            "aria-label": `Run ${drive.name}`,
            onClick: () => openRunDialog(drive),
          },
          icon("run"),
        ),
      el(
        "button",
        {
          class: "square plain",
          title: "Delete the drive",
          "aria-label": `Delete ${drive.name}`,
          onClick: () => removeDrive(drive).catch(showError),
        },
        icon("trash"),
      ),
    ),
    jobs.length > 0 && el("ul", { class: "jobs" }, jobs.map(jobRow)),
  );
}

/** @param {any} job */
function jobRow(job) {
  return el(
    "li",
    {},
    el(
      "button",
      {
        "aria-current": String(getState().job === job.id),
        onClick: () => setState({ drive: job.drive_id, job: job.id, panel: "job", frame: null, view: null }),
      },
      el("span", { class: "cut" }, jobTitle(job)),
      job.state === "successful" ? el("span", { class: "small" }, formatAgo(job.finished_at)) : stateBadge(job.state),
      job.state === "successful" && el("span", { class: "small number both" }, outcomeOf(job)),
    ),
  );
}

/** @param {any} job @returns {string} The result in a few words. */
export function outcomeOf(job) {
  const { intersections, report } = job.summary ?? {};
  const parts = [];
  if (intersections !== undefined) parts.push(plural(intersections, "intersection"));
  if (report?.ace_m !== undefined && report.ace_m !== null) parts.push(`ACE ${formatMetres(report.ace_m)}`);
  return parts.join(", ");
}

/** @param {any} drive */
async function removeDrive(drive) {
  if (
    !(await confirmAction(
      `Delete ${drive.name}?`,
      "Its scans, jobs and results are removed from the server. This cannot be undone.",
      "Delete the drive",
    ))
  )
    return;
  await sendJson("DELETE", `drives/${drive.id}`);
  if (getState().drive === drive.id) setState({ drive: null, job: null, frame: null, view: null, panel: "drives" });
  await refreshLists();
}
