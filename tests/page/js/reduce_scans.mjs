/**
 * Reduces scans as the page does: `node reduce_scans.mjs FOLDER SCHEME`.
 *
 * FOLDER holds NNNNNN.bin and NNNNNN.label; NNNNNN.ground is written beside them, or NNNNNN.error with the message.
 * SCHEME as in the form of the page; "auto" guesses it from all labels. Prints the scheme's name.
 */

import { openAsBlob } from "node:fs";
import { readdir, writeFile } from "node:fs/promises";
import { join } from "node:path";

import { groupsOf, guessScheme, namedScheme } from "../../../static/js/upload/labels.js";
import { countLabels, reduceScan } from "../../../static/js/upload/scan.js";

const [folder, choice] = process.argv.slice(2);
const stems = (await readdir(folder)).filter((name) => name.endsWith(".bin")).map((name) => name.slice(0, -4));
const open = (name) => openAsBlob(join(folder, name));

let scheme = namedScheme(choice);
if (!scheme) {
  const ids = new Set();
  for (const stem of stems) {
    for (const id of (await countLabels(await open(`${stem}.label`), stem)).keys()) ids.add(id);
  }
  scheme = guessScheme(ids, false);
}

for (const stem of stems) {
  const [scanName, labelName] = [`velodyne/${stem}.bin`, `labels/${stem}.label`];
  const files = { scan: await open(`${stem}.bin`), labels: await open(`${stem}.label`), scanName, labelName };
  try {
    await writeFile(join(folder, `${stem}.ground`), await reduceScan(files, groupsOf(scheme)));
  } catch (error) {
    await writeFile(join(folder, `${stem}.error`), error.message);
  }
}
console.log(scheme.name);
