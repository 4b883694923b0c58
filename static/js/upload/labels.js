/** Label schemes: which ids are road, and which are the ground that is most often confused with it. */

/**
 * @typedef {object} LabelScheme
 * @property {string} name
 * @property {number[]} road Ids of road.
 * @property {number[]} confusable Ids of sidewalk, parking and other ground.
 * @property {Set<number> | null} known All ids of the scheme; null where they are not known.
 */

/** @param {number} from @param {number} to @returns {number[]} from, ..., to - 1 */
const range = (from, to) => Array.from({ length: to - from }, (_, i) => from + i);

/** @type {LabelScheme} */
export const SEMANTICKITTI = {
  name: "semantickitti",
  road: [40, 60], // road and lane marking
  confusable: [44, 48, 49], // parking, sidewalk, other ground
  known: new Set([
    0,
    1,
    10,
    11,
    13,
    15,
    16,
    18,
    20,
    30,
    31,
    32,
    40,
    44,
    48,
    49,
    50,
    51,
    52,
    60,
    70,
    71,
    72,
    80,
    81,
    99,
    ...range(252, 260),
  ]),
};

/** @type {LabelScheme} */
export const LEARNING = { name: "learning", road: [9], confusable: [10, 11, 12], known: new Set(range(0, 20)) };

/** @type {LabelScheme} */
export const KITTI360 = {
  name: "kitti360",
  road: [7],
  confusable: [6, 8, 9], // ground, sidewalk, parking
  known: new Set([...range(0, 45), 65535]),
};

const SCHEMES = [SEMANTICKITTI, LEARNING, KITTI360];

/** Groups of the selection. */
export const ROAD = 1;
export const CONFUSABLE = 2;

/**
 * The scheme that was asked for; null for "auto".
 *
 * @param {string} choice A name, or ids of road as "40,60".
 * @returns {LabelScheme | null}
 */
export function namedScheme(choice) {
  if (choice === "auto") {
    return null;
  }
  const named = SCHEMES.find((scheme) => scheme.name === choice);
  if (named) {
    return named;
  }
  const fields = choice.split(/[,\s]+/).filter(Boolean);
  const road = [...new Set(fields.map(Number))].sort((a, b) => a - b);
  if (!fields.length || !fields.every((field) => /^\d+$/.test(field)) || road.some((id) => id > 0xffff)) {
    throw new Error(
      `Label scheme "${choice}": expected auto, semantickitti, learning, kitti360, or the ids of road separated by ` +
        "commas, as 40,60 (0 to 65535).",
    );
  }
  return { name: "custom", road, confusable: [], known: null };
}

/**
 * Tell the scheme from the ids that occur, as the service does.
 *
 * @param {Iterable<number>} ids Distinct ids of some scans.
 * @param {boolean} isKitti360 The pose lines are KITTI-360's.
 * @returns {LabelScheme}
 */
export function guessScheme(ids, isKitti360) {
  const found = [...ids];
  if (found.length && Math.max(...found) <= 19 && found.includes(9)) {
    return LEARNING;
  }
  const explains = (/** @type {LabelScheme} */ scheme) => found.every((id) => scheme.known?.has(id));
  return isKitti360 && explains(KITTI360) && !explains(SEMANTICKITTI) ? KITTI360 : SEMANTICKITTI;
}

/**
 * Table from id to group: 1 road, 2 confusable, 0 neither.
 *
 * @param {LabelScheme} scheme
 */
export function groupsOf(scheme) {
  const table = new Uint8Array(1 << 16);
  scheme.confusable.forEach((id) => (table[id] = CONFUSABLE));
  scheme.road.forEach((id) => (table[id] = ROAD));
  return table;
}
