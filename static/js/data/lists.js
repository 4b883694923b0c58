/**
 * The drives, jobs, trash and presets of the server, as last received: shared by header and panels.
 * @module data/lists
 */
import { getJson } from "../api.js";

/**
 * @type {{drives: any[], jobs: any[], trash: any[], presets: {name: string, description: string, config: any}[],
 *   isLoaded: boolean}}
 */
export const lists = { drives: [], jobs: [], trash: [], presets: [], isLoaded: false };

const MAX_ROWS = 500;

/** @type {Set<() => void>} */
const listeners = new Set();

/** @param {() => void} call */
export function onListsChange(call) {
  listeners.add(call);
}

/** Ask the server again. */
export async function refreshLists() {
  const [drives, jobs, trash] = await Promise.all([
    readPages("drives", "drives"),
    readPages("jobs", "jobs"),
    readPages("trash", "items"),
  ]);
  Object.assign(lists, { drives, jobs, trash, isLoaded: true });
  notify();
}

/** Ask for the presets, once: they show which settings of a job are its own. */
export async function loadPresets() {
  if (lists.presets.length) return;
  lists.presets = (await getJson("presets")).presets;
  if (lists.isLoaded) notify();
}

/** @param {any} job A job as just received: takes the place of the older one. */
export function rememberJob(job) {
  remember(lists.jobs, job);
}

/** @param {any} drive */
export function rememberDrive(drive) {
  remember(lists.drives, drive);
}

/** @param {any[]} rows @param {any} item */
function remember(rows, item) {
  const row = rows.findIndex((each) => each.id === item.id);
  if (row < 0) rows.unshift(item);
  else rows[row] = item;
  notify();
}

function notify() {
  for (const call of listeners) call();
}

/** @param {string} path @param {string} member @returns {Promise<any[]>} */
async function readPages(path, member) {
  const rows = [];
  let after = null;
  do {
    const page = await getJson(`${path}?limit=100${after ? `&after=${encodeURIComponent(after)}` : ""}`);
    rows.push(...page[member]);
    after = page.next;
  } while (after && rows.length < MAX_ROWS);
  return rows;
}

/**
 * @param {any} request Of a job.
 * @returns {Array<[string, any]>} Settings that differ from the preset: "bev.resolution_m", 0.25.
 */
export function ownSettings(request) {
  if (!request?.config) return [];
  const usual = flatten(lists.presets.find(({ name }) => name === (request.preset ?? "default"))?.config ?? {});
  const isOwn = (/** @type {[string, any]} */ [name, value]) =>
    name !== "preset" && usual.size > 0 && JSON.stringify(usual.get(name)) !== JSON.stringify(value);
  return [...flatten(request.config)].filter(isOwn);
}

/** @param {any} config @param {string} [prefix] @returns {Map<string, any>} Values by path: "bev.resolution_m". */
export function flatten(config, prefix = "") {
  /** @type {Map<string, any>} */
  const all = new Map();
  for (const [name, value] of Object.entries(config)) {
    const path = prefix + name;
    if (value === null || typeof value !== "object" || Array.isArray(value)) all.set(path, value);
    else for (const [inner, leaf] of flatten(value, `${path}.`)) all.set(inner, leaf);
  }
  return all;
}
