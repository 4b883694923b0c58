/** One scan with its labels, reduced to the points that the method can use. */

import { encodeGround } from "./ground.js";

const POINT_BYTES = 16;
const LABEL_BYTES = 4;

/**
 * Pick the points of two groups of labels, those of the first in front, each in the order of the scan.
 *
 * @param {ArrayBuffer} scan float32 x y z remission a point.
 * @param {ArrayBuffer} labels uint32 a point, the id in the lower 16 bits.
 * @param {Uint8Array} groups Group of every id: 1 road, 2 confusable.
 * @param {string} scanName For messages.
 * @param {string} labelName
 * @returns {{bits: Uint32Array, roadCount: number}} Bits of the coordinates, three a point.
 */
export function selectPoints(scan, labels, groups, scanName, labelName) {
  checkSizes(scan.byteLength, labels.byteLength, scanName, labelName);
  const words = new Uint32Array(scan); // bits, not numbers: what is kept stays as it was
  const ids = new Uint32Array(labels);
  let first = 0;
  let second = 0;
  for (let i = 0; i < ids.length; i += 1) {
    const group = groups[ids[i] & 0xffff];
    if (group === 1) {
      first += 1;
    } else if (group === 2) {
      second += 1;
    }
  }
  const bits = new Uint32Array(3 * (first + second));
  const next = [0, 0, 3 * first];
  for (let i = 0; i < ids.length; i += 1) {
    const group = groups[ids[i] & 0xffff];
    if (group === 1 || group === 2) {
      const at = next[group];
      next[group] = at + 3;
      for (let c = 0; c < 3; c += 1) {
        const value = words[4 * i + c];
        if ((value & 0x7f800000) === 0x7f800000) {
          throw new Error(
            `${scanName}: point ${i.toLocaleString("en")} of ${ids.length.toLocaleString("en")} is not finite. ` +
              "Expected x y z in metres. Usual cause: points without a return that were written as NaN; leave them " +
              "out, with their labels.",
          );
        }
        bits[at + c] = value;
      }
    }
  }
  return { bits, roadCount: first };
}

/**
 * Read, select and encode one scan.
 *
 * @param {{scan: Blob, labels: Blob, scanName: string, labelName: string}} files
 * @param {Uint8Array} groups
 */
export async function reduceScan({ scan, labels, scanName, labelName }, groups) {
  checkSizes(scan.size, labels.size, scanName, labelName);
  const buffers = await Promise.all([readWhole(scan, scanName), readWhole(labels, labelName)]);
  const { bits, roadCount } = selectPoints(buffers[0], buffers[1], groups, scanName, labelName);
  return encodeGround(bits, roadCount);
}

/**
 * Say how often each label id occurs.
 *
 * @param {Blob} labels
 * @param {string} name
 * @returns {Promise<Map<number, number>>}
 */
export async function countLabels(labels, name) {
  if (labels.size % LABEL_BYTES) {
    throw new Error(labelSizeComplaint(labels.size, name));
  }
  const counts = new Uint32Array(1 << 16);
  for (const label of new Uint32Array(await readWhole(labels, name))) {
    counts[label & 0xffff] += 1;
  }
  /** @type {Map<number, number>} */
  const found = new Map();
  counts.forEach((count, id) => count && found.set(id, count));
  return found;
}

/** @param {number} scanBytes @param {number} labelBytes @param {string} scanName @param {string} labelName */
export function checkSizes(scanBytes, labelBytes, scanName, labelName) {
  const complaint = sizeComplaint(scanBytes, labelBytes, scanName, labelName);
  if (complaint) {
    throw new Error(`${complaint.path}: ${complaint.message}`);
  }
}

/**
 * What is wrong with the sizes of a scan and its labels, if anything.
 *
 * @param {number} scanBytes
 * @param {number} labelBytes
 * @param {string} scanName
 * @param {string} labelName
 * @returns {{path: string, message: string} | null}
 */
export function sizeComplaint(scanBytes, labelBytes, scanName, labelName) {
  const text = (/** @type {number} */ value) => value.toLocaleString("en");
  if (scanBytes === 0) {
    return { path: scanName, message: "is empty. Usual cause: a copy or download that did not finish." };
  }
  if (scanBytes % POINT_BYTES) {
    return {
      path: scanName,
      message:
        `${text(scanBytes)} bytes, which is no multiple of 16. Expected four float32 a point (x y z remission). ` +
        "Usual cause: a file cut short while it was copied, or points with another number of values.",
    };
  }
  if (labelBytes % LABEL_BYTES) {
    return {
      path: labelName,
      message: `${text(labelBytes)} bytes, which is no multiple of 4. Expected one uint32 a point.`,
    };
  }
  const points = scanBytes / POINT_BYTES;
  const labels = labelBytes / LABEL_BYTES;
  if (points !== labels) {
    return {
      path: labelName,
      message:
        `${text(labels)} labels for ${text(points)} points in ${scanName}. Every point needs one 4-byte label. ` +
        "Usual cause: labels of another sequence, or an archive that was not unpacked to the end.",
    };
  }
  return null;
}

/** @param {number} size @param {string} name */
function labelSizeComplaint(size, name) {
  return `${name}: ${size.toLocaleString("en")} bytes, which is no multiple of 4. Expected one uint32 a point.`;
}

/** @param {Blob} blob @param {string} name */
async function readWhole(blob, name) {
  try {
    return await blob.arrayBuffer();
  } catch {
    throw new Error(
      `${name}: cannot be read. It was changed, moved or is on a disk that is gone; pick the folder again.`,
    );
  }
}
