/**
 * Reduces scans as the page does: `node reduce_scans.mjs FOLDER SCHEME`.
 *
 * FOLDER holds NNNNNN.bin and NNNNNN.label; NNNNNN.ground is written beside them, or NNNNNN.error with the message.
 * SCHEME as the service gives it, as JSON: ids of `road` and `confusable`.
 */

import { openAsBlob } from "node:fs";
import { readdir, writeFile } from "node:fs/promises";
import { join } from "node:path";

import { groupsOf, reduceScan } from "../../../static/js/upload/reduce.js";

const [folder, scheme] = process.argv.slice(2);
const stems = (await readdir(folder)).filter((name) => name.endsWith(".bin")).map((name) => name.slice(0, -4));
const groups = groupsOf(JSON.parse(scheme));
const open = (name) => openAsBlob(join(folder, name));

for (const stem of stems) {
  const [scanName, labelName] = [`velodyne/${stem}.bin`, `labels/${stem}.label`];
  const files = { scan: await open(`${stem}.bin`), labels: await open(`${stem}.label`), scanName, labelName };
  try {
    await writeFile(join(folder, `${stem}.ground`), await reduceScan(files, groups));
  } catch (error) {
    await writeFile(join(folder, `${stem}.error`), error.message);
  }
}
