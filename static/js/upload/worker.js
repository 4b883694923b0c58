/** Web worker: reduces scans away from the page, and computes the digests of what is left of them. */

import { sha256 } from "../api.js";
import { groupsOf, reduceScan } from "./reduce.js";

/** @type {Map<string, Uint8Array>} Tables of groups, by label scheme. */
const tables = new Map();

self.addEventListener("message", async ({ data: { files, scheme } }) => {
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
