/**
 * One scan with its labels, reduced to the points that the method can use, as bytes.
 *
 * Only the browser has the scans, and a hundredth of their bytes is of use: so this is done here, before anything is
 * sent, by the same rules and in the same format as `interloc convert --reduce` (the tests compare the two byte by byte).
 * The format is described in interloc/drives/scans/reduced_format.py.
 */

const POINT_BYTES = 16;
const LABEL_BYTES = 4;

const MAX_POINTS = 4_000_000;
const HEADER_BYTES = 16;
const MAGIC = 0x50474c49; // "ILGP", little endian
const VERSION = 1;

/** Groups of the selection. */
const ROAD = 1;
const CONFUSABLE = 2;

/**
 * Table from label id to group: 1 road, 2 confusable, 0 neither.
 * @param {{road: number[], confusable: number[]}} scheme
 */
export function groupsOf({ road, confusable }) {
  const table = new Uint8Array(1 << 16);
  for (const id of confusable) table[id] = CONFUSABLE;
  for (const id of road) table[id] = ROAD;
  return table;
}

/**
 * Pick the points of two groups of labels, those of the first in front, each in the order of the scan.
 *
 * @param {ArrayBuffer} scan float32 x y z remission per point.
 * @param {ArrayBuffer} labels uint32 per point, the id in the lower 16 bits.
 * @param {Uint8Array} groups Group of every id: 1 road, 2 confusable.
 * @param {string} scanName For messages.
 * @returns {{bits: Uint32Array, roadCount: number}} Bits of the coordinates, three per point.
 */
function selectPoints(scan, labels, groups, scanName) {
  const words = new Uint32Array(scan); // bits, not numbers: what is kept stays as it was
  const ids = new Uint32Array(labels);
  let first = 0;
  let second = 0;
  for (let i = 0; i < ids.length; i += 1) {
    const group = groups[ids[i] & 0xffff];
    if (group === ROAD) first += 1;
    else if (group === CONFUSABLE) second += 1;
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
  const { bits, roadCount } = selectPoints(buffers[0], buffers[1], groups, scanName);
  return encodeGround(bits, roadCount);
}

/** Say how often each label id occurs. @param {Blob} labels @param {string} name */
export async function countLabels(labels, name) {
  const counts = new Uint32Array(1 << 16);
  const whole = labels.slice(0, labels.size - (labels.size % LABEL_BYTES)); // the service says what is wrong with the rest
  for (const label of new Uint32Array(await readWhole(whole, name))) counts[label & 0xffff] += 1;
  /** @type {Map<number, number>} */
  const found = new Map();
  counts.forEach((count, id) => count && found.set(id, count));
  return found;
}

/**
 * What the sizes mean the service has said before anything is sent: here they need only be those of one scan.
 * @param {number} scanBytes
 * @param {number} labelBytes
 * @param {string} scanName
 * @param {string} labelName
 */
function checkSizes(scanBytes, labelBytes, scanName, labelName) {
  const points = scanBytes / POINT_BYTES;
  if (points && Number.isInteger(points) && labelBytes === LABEL_BYTES * points) return;
  const [scan, labels] = [scanBytes, labelBytes].map((bytes) => bytes.toLocaleString("en"));
  throw new Error(
    `${labelName}: ${labels} bytes of labels for ${scan} bytes of points in ${scanName}. Expected 4 bytes for each ` +
      "16. Usual cause: a file that was changed, or cut short, since the folder was picked; pick it again.",
  );
}

/** @param {Blob} blob @param {string} name */
export async function readWhole(blob, name) {
  try {
    return await blob.arrayBuffer();
  } catch {
    throw new Error(
      `${name}: cannot be read. It was changed, moved or is on a disk that is gone; pick the folder again.`,
    );
  }
}

/**
 * Sort the bytes of the differences along the points by their weight.
 *
 * @param {Uint32Array} bits Three per point: the bits of its coordinates.
 * @returns {Uint8Array<ArrayBuffer>} Twelve planes, each of one byte per point.
 */
function splitPlanes(bits) {
  const n = bits.length / 3;
  const planes = new Uint8Array(12 * n);
  for (let c = 0; c < 3; c += 1) {
    let before = 0;
    const first = c * n;
    const second = (3 + c) * n;
    const third = (6 + c) * n;
    const last = (9 + c) * n;
    for (let i = 0, at = c; i < n; i += 1, at += 3) {
      const value = bits[at];
      const step = (value - before) | 0;
      before = value;
      const folded = (step << 1) ^ (step >> 31);
      planes[first + i] = folded >>> 24;
      planes[second + i] = folded >>> 16;
      planes[third + i] = folded >>> 8;
      planes[last + i] = folded;
    }
  }
  return planes;
}

/**
 * Write the ground points of a scan.
 *
 * @param {Uint32Array} bits Three per point: the float32 bits of x, y, z in metres; road points first.
 * @param {number} roadCount How many points are road.
 */
async function encodeGround(bits, roadCount) {
  const count = bits.length / 3;
  if (count > MAX_POINTS) {
    const most = MAX_POINTS.toLocaleString("en");
    throw new Error(`${count.toLocaleString("en")} ground points; no scan has more than ${most}.`);
  }
  const zlib = new CompressionStream("deflate"); // zlib's format, with its checksum
  const planes = /** @type {ReadableStream} */ (new Response(splitPlanes(bits)).body).pipeThrough(zlib);
  const packed = new Uint8Array(await new Response(planes).arrayBuffer());
  const bytes = new Uint8Array(HEADER_BYTES + packed.length);
  const header = new DataView(bytes.buffer);
  [MAGIC, VERSION, count, roadCount].forEach((value, i) => header.setUint32(4 * i, value, true));
  bytes.set(packed, HEADER_BYTES);
  return bytes;
}
