/** What a browser remembers for the page. Where its storage is switched off, the page remembers until it is closed. */

/** @type {Map<string, string>} */
const own = new Map();

/** @param {"localStorage" | "sessionStorage"} kind */
function storage(kind) {
  try {
    return globalThis[kind] ?? null; // even to look at it is an error where cookies are blocked
  } catch {
    return null;
  }
}

/** @param {string} key @param {"localStorage" | "sessionStorage"} [kind] */
export function recall(key, kind = "localStorage") {
  return own.get(key) ?? storage(kind)?.getItem(key) ?? null;
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
