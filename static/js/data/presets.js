/**
 * The presets, to tell which settings of a job are its own.
 * @module data/presets
 */
import { getJson } from "../api.js";
import { touchLists } from "./lists.js";

/** @type {Map<string, any>} Name -> configuration. */
const presets = new Map();

/** Ask for the presets, once. */
export async function loadPresets() {
  if (presets.size) return;
  const answer = await getJson("presets");
  for (const { name, config } of answer.presets) presets.set(name, config);
  touchLists();
}

/**
 * @param {any} request Of a job.
 * @returns {Array<[string, any]>} Settings that differ from the preset: "bev.resolution_m", 0.25.
 */
export function ownSettings(request) {
  if (!request?.config) return [];
  const usual = flat(presets.get(request.preset ?? "default") ?? {});
  return [...flat(request.config)].filter(
    ([name, value]) => name !== "preset" && usual.size > 0 && JSON.stringify(usual.get(name)) !== JSON.stringify(value),
  );
}

/** @param {any} value @param {string} [prefix] @returns {Map<string, any>} */
function flat(value, prefix = "") {
  const all = new Map();
  for (const [name, each] of Object.entries(value)) {
    if (each !== null && typeof each === "object" && !Array.isArray(each))
      for (const [inner, leaf] of flat(each, `${prefix}${name}.`)) all.set(inner, leaf);
    else all.set(prefix + name, each);
  }
  return all;
}
