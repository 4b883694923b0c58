/** Keys that work wherever the focus is, and the dialog that lists them. */
import { factRows } from "./controls.js";
import { el, isTyping } from "./dom.js";
import { openDialog } from "./messages.js";

/** @typedef {{key: string, label: string, text: string, call: () => void}} Shortcut */

/** @type {Map<string, Shortcut>} */
const shortcuts = new Map();
const PRESSED_BY_SPACE = "button, summary, a, input:not([type=range])";

/** What controls do with keys by themselves. */
const OF_CONTROLS = [
  ["← → ↑ ↓", "Move the map, the timeline or the choice of the panel that has the focus"],
  ["+ −", "Zoom the map that has the focus"],
  ["Tab", "On to the next control"],
  ["Esc", "Close the dialog that is open"],
];

/**
 * @param {string} key As of `KeyboardEvent.key`.
 * @param {string} text What it does, for the list.
 * @param {() => void} call
 * @param {string} [label] The key as it is printed.
 */
export function addShortcut(key, text, call, label = key) {
  shortcuts.set(key, { key, label, text, call });
}

/** @param {KeyboardEvent} event */
function press(event) {
  const found = shortcuts.get(event.key);
  if (!found || isTyping(event) || event.defaultPrevented) return;
  if (event.repeat && /^[1-4u ]$/.test(event.key)) return; // a key held down says what is seen once
  if (event.key === " " && /** @type {Element} */ (event.target).closest(PRESSED_BY_SPACE)) return;
  event.preventDefault(); // a space would scroll
  found.call();
}

/** Show all shortcuts. */
export function listShortcuts() {
  const rows = [...shortcuts.values()].map(({ label, text }) => [label, text]);
  const keysOf = (/** @type {string} */ keys) => keys.split(" ").map((each) => el("kbd", each));
  const list = factRows([...rows, ...OF_CONTROLS].map(([keys, text]) => [keysOf(keys), text]));
  openDialog("Keyboard shortcuts", el("dl.shortcuts", list));
}

/** Listen to the keys of the page. */
export function mountShortcuts() {
  addShortcut("?", "This list", listShortcuts);
  document.addEventListener("keydown", press);
}
