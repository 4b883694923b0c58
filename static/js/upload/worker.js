/** Web worker: reduces scans, with the digests of what is left of them, or looks into a map, away from the page. */

import { sha256 } from "../api.js";
import { lookIntoMap } from "./osm_roads.js";
import { groupsOf, reduceScan } from "./reduce.js";

/** @type {Map<string, Uint8Array>} Tables of groups, by label scheme. */
const tables = new Map();

self.addEventListener("message", async ({ data: { map, positions, words, files, scheme } }) => {
  if (map) {
    self.postMessage(await lookIntoMap(map, positions, words).catch(() => null)); // the service says what is wrong with it
    return;
  }
  try {
    const key = JSON.stringify([scheme.road, scheme.confusable]);
    const groups = tables.get(key) ?? groupsOf(scheme);
    tables.set(key, groups);
    const data = await reduceScan(files, groups);
    self.postMessage({ data, digest: await sha256(data) }, { transfer: [data.buffer] });
  } catch (error) {
    self.postMessage({ error: error instanceof Error ? error.message : String(error) });
  }
});
