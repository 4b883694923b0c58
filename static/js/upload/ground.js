/**
 * The ground points of one scan as bytes: the `.ground` files of a reduced drive, as `interloc reduce` writes them.
 *
 * A header of 16 bytes (magic, version, number of points, number of road points; uint32, little endian), then a zlib
 * stream of twelve planes of bytes: each coordinate's float32 bits as the difference to the point before, folded so
 * that small differences of either sign are small numbers, the highest bytes of x, y and z first.
 */

export const MAX_POINTS = 4_000_000;

const HEADER_BYTES = 16;
const MAGIC = 0x50474c49; // "ILGP", little endian
const VERSION = 1;

/**
 * Sort the bytes of the differences along the points by their weight.
 *
 * @param {Uint32Array} bits Three a point: the bits of its coordinates.
 * @returns {Uint8Array<ArrayBuffer>} Twelve planes, each of one byte a point.
 */
export function splitPlanes(bits) {
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
 * @param {Uint32Array} bits Three a point: the float32 bits of x, y, z in metres; road points first.
 * @param {number} roadCount How many points are road.
 * @returns {Promise<Uint8Array<ArrayBuffer>>}
 */
export async function encodeGround(bits, roadCount) {
  const count = bits.length / 3;
  if (count > MAX_POINTS) {
    throw new Error(
      `${count.toLocaleString("en")} ground points; no scan has more than ${MAX_POINTS.toLocaleString("en")}.`,
    );
  }
  const header = new DataView(new ArrayBuffer(HEADER_BYTES));
  [MAGIC, VERSION, count, roadCount].forEach((value, i) => header.setUint32(4 * i, value, true));
  return join([new Uint8Array(header.buffer), ...(await deflate(splitPlanes(bits)))]);
}

/** @param {Uint8Array<ArrayBuffer>} bytes */
async function deflate(bytes) {
  const stream = new CompressionStream("deflate"); // zlib's format, with its checksum
  const writer = stream.writable.getWriter();
  const written = writer.write(bytes).then(() => writer.close());
  const pieces = [];
  const reader = stream.readable.getReader();
  for (let piece = await reader.read(); !piece.done; piece = await reader.read()) {
    pieces.push(piece.value);
  }
  await written;
  return pieces;
}

/** @param {Uint8Array[]} pieces @returns {Uint8Array<ArrayBuffer>} */
function join(pieces) {
  const whole = new Uint8Array(pieces.reduce((size, piece) => size + piece.length, 0));
  let at = 0;
  for (const piece of pieces) {
    whole.set(piece, at);
    at += piece.length;
  }
  return whole;
}
