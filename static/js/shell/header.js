/**
 * The header: product, drive and job at hand, token, links.
 * @module shell/header
 */
import { getJson, getToken, onTokenChange, ROOT, setToken } from "../api.js";
import { lists, onListsChange, refreshLists } from "../data/lists.js";
import { loadPresets, ownSettings } from "../data/presets.js";
import { el, fill, formatAgo, icon } from "../dom.js";
import { getState, setState, subscribe } from "../state.js";
import { getConfig } from "./config.js";
import { showError } from "./messages.js";
import { askForToken } from "./token.js";

/** @param {HTMLElement} header */
export function mountHeader(header) {
  const drives = el("select", { "aria-label": "Drive", onChange: () => openDrive(drives.value) });
  const jobs = el("select", {
    "aria-label": "Job",
    onChange: () => setState({ job: jobs.value || null, frame: null, view: null }),
  });
  const token = el("button", { class: "plain", onClick: () => changeToken().catch(showError) });
  fill(
    header,
    el(
      "a",
      { class: "brand", href: "#", onClick: home },
      el("img", { src: new URL("static/icon.svg", ROOT).href, alt: "", width: 22, height: 22 }),
      "InterLoc",
    ),
    el(
      "nav",
      { class: "switcher", "aria-label": "Drive and job" },
      drives,
      el("span", { class: "quiet", "aria-hidden": "true" }, "/"),
      jobs,
    ),
    el("span", { class: "grow" }),
    token,
    el("a", { class: "button plain", href: new URL("docs", ROOT).href, target: "_blank", rel: "noopener" }, "API"),
    el("span", { class: "small version" }, getConfig().version && `v${getConfig().version}`),
  );

  const update = () => {
    const { drive, job } = getState();
    const known = lists.drives.some((each) => each.id === drive);
    fill(
      drives,
      el("option", { value: "" }, lists.drives.length ? "Choose a drive" : "No drive yet"),
      drive && !known && el("option", { value: drive }, drive),
      lists.drives.map((each) => el("option", { value: each.id }, each.name)),
    );
    drives.value = drive ?? "";
    const own = lists.jobs.filter((each) => each.drive_id === drive);
    fill(
      jobs,
      el("option", { value: "" }, own.length ? "Choose a job" : "No job yet"),
      job && !own.some((each) => each.id === job) && el("option", { value: job }, job),
      own.map((each) => el("option", { value: each.id }, jobName(each))),
    );
    jobs.value = job ?? "";
    jobs.disabled = !drive;
    token.hidden = !getConfig().needs_token && !getToken();
    fill(token, icon("key"), getToken() ? "Token set" : "Set token");
  };
  subscribe(["drive", "job"], update);
  subscribe(["drive"], ({ drive }) => {
    if (drive && lists.isLoaded && !lists.drives.some((each) => each.id === drive)) refreshLists().catch(showError); // just uploaded
  });
  onListsChange(update);
  onTokenChange(update);
  update();
  loadPresets().catch(showError);
  refreshLists().catch(showError);
}

/** @param {any} job @returns {string} Its name, or what it was asked for. */
export function jobTitle(job) {
  const request = job.request ?? {};
  if (request.name) return request.name;
  const parts = [`Preset ${request.preset ?? "default"}`];
  if (request.osm) parts.push(`policy ${request.policy ?? "drive"}`);
  if (ownSettings(request).length) parts.push("own settings");
  return parts.join(", ");
}

/** @param {any} job @returns {string} Its title, and when it ended or how it stands. */
export function jobName(job) {
  return `${jobTitle(job).replace("Preset ", "").replace("policy ", "")} · ${job.state === "successful" ? formatAgo(job.finished_at ?? job.created_at) : job.state}`;
}

/** @param {string} id Show a drive, with its newest job if there is one. */
export function openDrive(id) {
  const job =
    lists.jobs.find((each) => each.drive_id === id && each.state === "successful") ??
    lists.jobs.find((each) => each.drive_id === id);
  setState({ drive: id || null, job: job?.id ?? null, frame: null, view: null, panel: job ? "job" : "drives" });
}

/** @param {Event} event */
function home(event) {
  event.preventDefault();
  setState({ panel: "drives" });
}

async function changeToken() {
  const token = await askForToken(false);
  if (!token) return;
  setToken(token);
  await getJson("drives?limit=1");
  await refreshLists();
}
