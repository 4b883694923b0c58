/** What the label ids of a drive mean, judged from a few of its scans as the service does. */

import { guessScheme, LEARNING, namedScheme } from "./labels.js";
import { error, listed, pathOf, warning } from "./numbered.js";
import { countLabels } from "./scan.js";

/** @typedef {import("./labels.js").LabelScheme} LabelScheme */
/** @typedef {import("./numbered.js").FileProblem} FileProblem */

/**
 * @typedef {object} Judgement
 * @property {LabelScheme} scheme
 * @property {Map<number, number>} counts How many points of the scans looked into carry each id.
 * @property {number} roadShare
 * @property {number} groundShare Of road, sidewalk, parking and other ground: what is left of a scan.
 * @property {FileProblem[]} problems
 */

const SAMPLED = 5;
const MIN_ROAD_SHARE = 0.005;
const MAX_UNKNOWN_SHARE = 0.05;

/**
 * Some of many numbers, evenly spread from the first to the last.
 *
 * @param {number[]} numbers
 * @param {number} [count]
 */
export function sampleOf(numbers, count = SAMPLED) {
  if (numbers.length <= count) return numbers;
  return Array.from({ length: count }, (_, i) => numbers[Math.round((i * (numbers.length - 1)) / (count - 1))]);
}

/**
 * Look into some label files.
 *
 * @param {import("./numbered.js").NumberedFiles} labels
 * @param {number[]} frames Scans to look into.
 * @param {string} choice Scheme that was asked for: auto, a name, or ids of road.
 * @param {boolean} isKitti360 The pose lines are KITTI-360's.
 * @returns {Promise<Judgement>}
 */
export async function judgeLabels(labels, frames, choice, isKitti360) {
  const named = namedScheme(choice);
  /** @type {Map<number, number>} */
  const counts = new Map();
  for (const frame of frames) {
    const file = labels.files.get(frame);
    if (!file) continue;
    for (const [id, count] of await countLabels(file, pathOf(labels, frame)))
      counts.set(id, (counts.get(id) ?? 0) + count);
  }
  const scheme = named ?? guessScheme(counts.keys(), isKitti360);
  const total = sum(counts.values());
  const road = sum(scheme.road.map((id) => counts.get(id) ?? 0));
  const ground = road + sum(scheme.confusable.map((id) => counts.get(id) ?? 0));
  const problems = total ? complaints(labels.folder, scheme, counts, road, total) : [];
  return { scheme, counts, roadShare: total ? road / total : 0, groundShare: total ? ground / total : 0, problems };
}

/**
 * @param {string} folder
 * @param {LabelScheme} scheme
 * @param {Map<number, number>} counts
 * @param {number} road Points of road.
 * @param {number} total
 * @returns {FileProblem[]}
 */
function complaints(folder, scheme, counts, road, total) {
  const ids = [...counts.keys()].sort((a, b) => a - b);
  if (scheme.name !== "custom" && scheme.name !== LEARNING.name && guessScheme(ids, false) === LEARNING) {
    const text = `all ids are 19 or less (${listed(ids, 20)}), which looks like the learning scheme (0..19, road = 9), but they are to be read as ${scheme.name}.`;
    return [
      error(
        folder,
        `${text} Choose scheme "learning". Usual cause: predictions that were not mapped back to the ids of the labels.`,
      ),
    ];
  }
  const problems = [];
  const unknown = ids.filter((id) => scheme.known && !scheme.known.has(id));
  const unknownShare = sum(unknown.map((id) => counts.get(id) ?? 0)) / total;
  if (unknownShare > MAX_UNKNOWN_SHARE) {
    const text = `${percent(unknownShare)} of the points have ids that ${scheme.name} does not know (${listed(unknown, 12)}).`;
    problems.push(warning(folder, `${text} Usual cause: another label scheme; name it, or give the ids of road.`));
  }
  const wanted = listed(scheme.road, 12);
  if (road === 0) {
    const text = `no point of the scans looked at is road: the ids are ${listed(ids, 20)}; road would be ${wanted} (scheme ${scheme.name}).`;
    problems.push(error(folder, `${text} Usual cause: another label scheme; name it, or give the ids of road.`));
  } else if (road < MIN_ROAD_SHARE * total) {
    const text = `only ${percent(road / total)} of the points are road (ids ${wanted}); 10 to 40 % are usual.`;
    problems.push(warning(folder, `${text} Usual cause: another label scheme, or labels of other scans.`));
  }
  return problems;
}

const GROUND_POINT_BYTES = 7; // packed without loss, scans of 64 beams

/**
 * About how large the ground points of a scan are, by all label folders together.
 *
 * @param {import("./drive_folder.js").DriveFolder} drive
 * @param {Iterable<Judgement>} judged
 */
export function groundBytesOf(drive, judged) {
  const points = drive.scans ? drive.scans.bytes / 16 / drive.scans.files.size : 0;
  return sum([...judged].map(({ groundShare }) => groundShare * points * GROUND_POINT_BYTES));
}

/** @param {Iterable<number>} values */
function sum(values) {
  let total = 0;
  for (const value of values) total += value;
  return total;
}

/** @param {number} share */
const percent = (share) => `${(100 * share).toFixed(1)} %`;
