/**
 * Which uploads are under way, in this tab and in others of this browser: no drive is sent by two of them.
 *
 * Tabs talk through a BroadcastChannel, which plain http has too; locks (Web Locks) it has not. A tab that is asked
 * answers at once, even in the background, where timers hardly run.
 */
import { formatPercent } from "../dom.js";
import { news } from "../news.js";
import { refreshLists } from "./lists.js";

/**
 * @typedef {object} Sending
 * @property {string} driveId
 * @property {string} fingerprint Of the files; "" where they have none.
 * @property {number|null} fraction Of the files that were sent, 0..1; null before and after.
 * @property {boolean} isElsewhere Another tab sends it.
 */

const ANSWER_MS = 300;
const SILENT_MS = 4000;
const REPEAT_MS = 500;
const TAB = Math.random().toString(36).slice(2);

const channel = typeof BroadcastChannel === "function" ? new BroadcastChannel("interloc.uploads") : null;
/** @type {any} */ (channel)?.unref?.(); // Node, in tests, would wait for it
/** @type {Sending|null} */
let own = null;
let told = 0;
let timer = 0;
/** Of the other tabs, with when they were last heard of. @type {Map<string, {upload: Sending, at: number}>} */
const others = new Map();
const changes = news();
export const onUploadsChange = changes.hear;

/** @returns {Sending|null} What this tab sends. */
export const ownUpload = () => own;

/** @param {string} driveId @returns {Sending|null} The upload of a drive that is under way, in whichever tab. */
export function uploadOf(driveId) {
  if (own?.driveId === driveId) return own;
  return [...others.values()].find(({ upload }) => upload.driveId === driveId)?.upload ?? null;
}

/** @param {Sending} upload @returns {string} "Uploading, 43 %" */
export function uploadText({ isElsewhere, fraction }) {
  const share = fraction === null ? "" : `, ${percent(fraction)}`;
  return `${isElsewhere ? "Another tab sends it" : "Uploading"}${share}`;
}

/** @param {number} fraction @returns {string} "43 %" */
export const percent = (fraction) => formatPercent(Math.floor(100 * fraction) / 100).replace(".0", "");

/** Say what this tab sends; null: nothing any more. @param {Omit<Sending, "isElsewhere">|null} upload */
export function tellUpload(upload) {
  const before = own;
  own = upload && { ...upload, isElsewhere: false };
  if (!own && before) channel?.postMessage({ tab: TAB, kind: "ended" });
  else if (own && (own.driveId !== before?.driveId || performance.now() - told > REPEAT_MS)) tell();
  if (own?.driveId !== before?.driveId) void refreshLists().catch(() => {}); // they show it later, then
  changes.tell();
}

/**
 * @param {string|null} driveId
 * @param {string} fingerprint
 * @returns {Promise<Sending|null>} The upload of the same drive, or of the same files, in another tab.
 */
export async function uploadElsewhere(driveId, fingerprint) {
  if (!channel) return null;
  channel.postMessage({ tab: TAB, kind: "who" });
  await new Promise((resolve) => setTimeout(resolve, ANSWER_MS));
  const isSame = (/** @type {Sending} */ each) =>
    each.driveId === driveId || (fingerprint !== "" && each.fingerprint === fingerprint);
  return [...others.values()].map(({ upload }) => upload).find(isSame) ?? null;
}

function tell() {
  told = performance.now();
  channel?.postMessage({ tab: TAB, kind: "sending", upload: own });
}

/** @param {string} tab */
function forget(tab) {
  if (!others.delete(tab)) return;
  void refreshLists().catch(() => {});
  changes.tell();
}

channel?.addEventListener("message", ({ data: { tab, kind, upload } }) => {
  if (kind === "who" && own) tell();
  if (kind === "ended") forget(tab);
  if (kind !== "sending") return;
  const isNew = others.get(tab)?.upload.driveId !== upload.driveId;
  if (!others.size) setTimeout(watch);
  others.set(tab, { upload: { ...upload, isElsewhere: true }, at: performance.now() });
  if (isNew) void refreshLists().catch(() => {});
  changes.tell();
});
if (channel) {
  globalThis.addEventListener?.("pagehide", () => own && channel.postMessage({ tab: TAB, kind: "ended" }));
  globalThis.addEventListener?.("pageshow", () => own && tell()); // it was not closed, but kept for "back"
  channel.postMessage({ tab: TAB, kind: "who" });
}

/** Ask the other tabs now and then, as long as one sends: it may be closed by force. */
function watch() {
  clearTimeout(timer);
  if (!others.size) return;
  timer = window.setTimeout(() => {
    for (const [tab, { at }] of others) if (performance.now() - at > 2 * SILENT_MS) forget(tab);
    channel?.postMessage({ tab: TAB, kind: "who" });
    watch();
  }, SILENT_MS);
}
