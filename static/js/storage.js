/** What a browser remembers for the page. Where its storage is switched off, the page remembers until it is closed. */

/** @type {Map<string, string>} */
const own = new Map();

/** @param {string} key @param {"localStorage" | "sessionStorage"} [kind] */
export function recall(key, kind = "localStorage") {
  try {
    return own.get(key) ?? globalThis[kind].getItem(key);
  } catch {
    return null; // even to look at the storage is an error where cookies are blocked
  }
}

/**
 * @param {string} key
 * @param {string | null} value null: forget it.
 * @param {"localStorage" | "sessionStorage"} [kind] Until it is cleared, or until the tab is closed.
 */
export function keep(key, value, kind = "localStorage") {
  own.delete(key);
  try {
    const kept = globalThis[kind];
    if (value === null) kept.removeItem(key);
    else kept.setItem(key, value);
  } catch {
    if (value !== null) own.set(key, value); // switched off, or full
  }
}
