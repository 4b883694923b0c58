/** The job that is to run on a drive. */

import { OSM_FILE } from "./drive_folder.js";
import { listPresent } from "./sending.js";

/**
 * @typedef {object} JobSettings
 * @property {string} preset
 * @property {Record<string, any> | null} config Settings that differ from the preset.
 * @property {string | null} labels
 * @property {{file: string} | {overpass: true} | {inside: true} | null} osm `inside`: the map that an archive holds, if any.
 * @property {string} policy
 * @property {number} tolerance_m
 * @property {string} key Sent with the request, so that a repetition makes no second job.
 */

/** @returns {string} A key that no other request has. */
export function newKey() {
  return [...crypto.getRandomValues(new Uint8Array(16))].map((byte) => byte.toString(16).padStart(2, "0")).join("");
}

/**
 * @param {import("./transfer.js").Transfer} transfer
 * @param {string} driveId
 * @param {JobSettings} settings
 * @returns {Promise<string>} Id of the job.
 */
export async function submitJob(transfer, driveId, { key, osm, ...settings }) {
  const map = osm && "inside" in osm ? await mapInside(transfer) : osm;
  const json = { drive_id: driveId, ...settings, osm: map };
  const { body } = await transfer.ask("jobs", { method: "POST", json, headers: { "Idempotency-Key": key } });
  return body.id;
}

/** @param {import("./transfer.js").Transfer} transfer @returns {Promise<{file: string} | null>} */
export async function mapInside(transfer) {
  const paths = [...(await listPresent(transfer)).keys()].filter((path) => OSM_FILE.test(path));
  return paths.length ? { file: paths[0] } : null;
}
