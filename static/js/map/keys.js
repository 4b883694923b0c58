/**
 * The keys of the map: they work anywhere but in fields and dialogs.
 * @module map/keys
 */
import { isTyping } from "../dom.js";
import { MEASURE_KEYS } from "./measure.js";
import { QUEUE_KEYS } from "./queue.js";

/** @type {{key: string, text: string, run: () => void}[]} For a list of shortcuts, too. */
export const SHORTCUTS = [...QUEUE_KEYS, ...MEASURE_KEYS];

/** Listen to them. */
export function listenToKeys() {
  document.addEventListener("keydown", (event) => {
    if (!isTyping(event)) SHORTCUTS.find(({ key }) => key === event.key)?.run();
  });
}
