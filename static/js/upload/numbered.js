/** The numbered files of a folder: `velodyne/000000.bin`, `labels/000000.label`, ... */

/**
 * @typedef {object} NumberedFiles
 * @property {string} folder Path inside the drive.
 * @property {string} suffix With its dot.
 * @property {number} digits Width that the numbers are padded to.
 * @property {Map<number, File>} files By number, ascending.
 * @property {number} bytes Of all of them.
 */

/** @typedef {{severity: "error" | "warning" | "note", path: string, message: string}} FileProblem */

/**
 * Take the numbered files of one folder out of many.
 *
 * @param {Map<string, File>} files By name inside the folder.
 * @param {string} folder
 * @param {string} suffix
 * @param {FileProblem[]} problems Added to where a name is none of a scan.
 * @returns {NumberedFiles | null} null where there is none.
 */
export function numberedFiles(files, folder, suffix, problems) {
  /** @type {[number, File, string][]} */
  const found = [];
  for (const [name, file] of files) {
    if (!name.endsWith(suffix)) continue;
    const stem = name.slice(0, -suffix.length);
    if (!/^\d{1,15}$/.test(stem)) {
      problems.push(error(`${folder}/${name}`, `is not named by its scan number. Expected names as 000000${suffix}.`));
      continue;
    }
    found.push([Number(stem), file, stem]);
  }
  if (!found.length) return null;
  found.sort((a, b) => a[0] - b[0]);
  const digits = found.reduce((least, [, , stem]) => Math.min(least, stem.length), Infinity);
  const odd = found.find(([number, , stem]) => stem !== String(number).padStart(digits, "0"));
  if (odd) {
    const text = `is numbered otherwise than its neighbours (${digits} digits). Usual cause: files of two drives in one folder.`;
    problems.push(error(`${folder}/${odd[2]}${suffix}`, text));
  }
  return {
    folder,
    suffix,
    digits,
    files: new Map(found.map(([number, file]) => [number, file])),
    bytes: found.reduce((sum, [, file]) => sum + file.size, 0),
  };
}

/** @param {NumberedFiles} numbered @param {number} number @returns {string} Path inside the drive. */
export function pathOf(numbered, number) {
  return `${numbered.folder}/${String(number).padStart(numbered.digits, "0")}${numbered.suffix}`;
}

/** @param {Iterable<number>} numbers Ascending. @returns {[number, number][]} Runs: [first, count]. */
export function runsOf(numbers) {
  /** @type {[number, number][]} */
  const runs = [];
  for (const number of numbers) {
    const last = runs.at(-1);
    if (last && last[0] + last[1] === number) last[1] += 1;
    else runs.push([number, 1]);
  }
  return runs;
}

/** @param {number[]} numbers @param {number} [most] @returns {string} "3, 4, 5 and 12 more" */
export function listed(numbers, most = 5) {
  const head = numbers.slice(0, most).join(", ");
  return numbers.length > most ? `${head} and ${(numbers.length - most).toLocaleString("en")} more` : head;
}

/** @param {string} path @param {string} message @returns {FileProblem} */
export const error = (path, message) => ({ severity: "error", path, message });
/** @param {string} path @param {string} message @returns {FileProblem} */
export const warning = (path, message) => ({ severity: "warning", path, message });
/** @param {string} path @param {string} message @returns {FileProblem} */
export const note = (path, message) => ({ severity: "note", path, message });

const ORDER = ["error", "warning", "note"];

/** @param {FileProblem[]} problems @returns {FileProblem[]} Errors first. */
export function sorted(problems) {
  return [...problems].sort((a, b) => ORDER.indexOf(a.severity) - ORDER.indexOf(b.severity));
}
