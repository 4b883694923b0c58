/** SHA-256 of what is sent, where the browser offers it (https, or this machine). */

/** @param {BufferSource} bytes @returns {Promise<Uint8Array | null>} */
async function sha256(bytes) {
  return globalThis.crypto?.subtle ? new Uint8Array(await crypto.subtle.digest("SHA-256", bytes)) : null;
}

/** @param {BufferSource} bytes @returns {Promise<string | null>} Base64; null where the browser cannot make it. */
export async function sha256Base64(bytes) {
  const hash = await sha256(bytes);
  return hash && btoa(String.fromCharCode(...hash));
}

/** @param {BufferSource} bytes @returns {Promise<string | null>} Hexadecimal; null where the browser cannot make it. */
export async function sha256Hex(bytes) {
  const hash = await sha256(bytes);
  return hash && [...hash].map((byte) => byte.toString(16).padStart(2, "0")).join("");
}
