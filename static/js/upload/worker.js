/** Web worker: reduces scans, and counts label ids, away from the page. */

import { sha256Base64 } from "./digest.js";
import { groupsOf } from "./labels.js";
import { countLabels, reduceScan } from "./scan.js";

/** @type {Map<string, Uint8Array>} */
const tables = new Map();

/** @param {import("./labels.js").LabelScheme} scheme */
function tableOf(scheme) {
  const key = JSON.stringify([scheme.road, scheme.confusable]);
  const table = tables.get(key) ?? groupsOf(scheme);
  tables.set(key, table);
  return table;
}

const WORK = {
  /** @param {any} task */
  async reduce({ files, scheme }) {
    const bytes = await reduceScan(files, tableOf(scheme));
    return { bytes, digest: await sha256Base64(bytes) };
  },

  /** @param {any} task */
  async count({ labels, name }) {
    return { counts: await countLabels(labels, name) };
  },
};

self.addEventListener("message", async ({ data: { id, kind, task } }) => {
  try {
    const result = await WORK[/** @type {keyof typeof WORK} */ (kind)](task);
    const moved = "bytes" in result ? [result.bytes.buffer] : [];
    self.postMessage({ id, result }, { transfer: moved });
  } catch (error) {
    self.postMessage({ id, error: error instanceof Error ? error.message : String(error) });
  }
});
