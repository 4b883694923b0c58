/** The upload that this tab sends. */
import { formatPercent } from "../dom.js";
import { news } from "../news.js";
import { refreshLists } from "./lists.js";

/**
 * @typedef {object} Sending
 * @property {string} driveId
 * @property {number|null} fraction Of the files that were sent, 0..1; null before and after.
 */

/** @type {Sending|null} */
let own = null;
const changes = news();
export const onUploadsChange = changes.hear;

/** @returns {Sending|null} */
export const ownUpload = () => own;

/** @param {Sending} upload @returns {string} "Uploading, 43 %" */
export const uploadText = ({ fraction }) => (fraction === null ? "Uploading" : `Uploading, ${percent(fraction)}`);

/** @param {number} fraction @returns {string} "43 %" */
export const percent = (fraction) => formatPercent(Math.floor(100 * fraction) / 100).replace(".0", "");

/** Say what this tab sends; null: nothing any more. @param {Sending|null} upload */
export function tellUpload(upload) {
  const isOther = own?.driveId !== upload?.driveId;
  own = upload;
  if (isOther) void refreshLists().catch(() => {}); // they show it later, then
  changes.tell();
}
