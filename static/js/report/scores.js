/** Figures of a report at distances D, and what the paper has beside them. */
import { getConfig } from "../api.js";

/**
 * @param {any} report
 * @returns {Array<{d: number, precision: number|null, recall: number|null, f1: number|null}>} Ascending.
 */
export function curve(report) {
  const distances = Object.keys(report.precision).map(Number);
  return distances.sort((a, b) => a - b).map((d) => ({ d, ...at(report, d) }));
}

/** @param {any} report @param {number} d */
export function at(report, d) {
  const key = d.toFixed(1);
  return {
    precision: report.precision[key] ?? null,
    recall: report.recall[key] ?? null,
    f1: report.f1[key] ?? null,
    tp: report.tp[key] ?? 0,
    fp: report.fp[key] ?? 0,
    fn: report.fn[key] ?? 0,
  };
}

/**
 * @param {string} name Of a drive.
 * @returns {string|null} The KITTI odometry sequence that it seems to be, "00" to "10".
 */
export function sequenceOf(name) {
  for (const [raw, sequence] of Object.entries(getConfig().raw_sequences)) if (name.includes(raw)) return sequence;
  const found = /(?:^|sequences?[ _/-]?|kitti[ _/-]?|seq[ _/-]?)(0\d|10)(?!\d)/i.exec(name.trim());
  return found ? found[1] : null;
}

/**
 * Count errors into bins of equal width; the last one takes all beyond.
 * @param {number[]} errors
 * @param {number} width
 * @param {number} bins
 * @returns {number[]}
 */
export function histogram(errors, width, bins) {
  const counts = new Array(bins + 1).fill(0);
  for (const error of errors) counts[Math.min(bins, Math.floor(error / width))] += 1;
  return counts;
}
