/** What was deleted and can be restored: below the drives, shown while there is anything. */
import { sendJson } from "../api.js";
import { lists, onListsChange, refreshLists } from "../data/lists.js";
import { announce, el, fill, formatAgo, formatBytes } from "../dom.js";
import { formatHours } from "../job/words.js";
import { confirmAction, showError } from "../messages.js";

/** @returns {HTMLElement} */
export function trashSection() {
  const summary = el("summary");
  const body = el("div.stack-s");
  const section = el("details.section.trash", { hidden: true }, summary, body);
  const update = () => {
    section.hidden = lists.trash.length === 0;
    fill(summary, `Trash (${lists.trash.length})`);
    fill(
      body,
      el("ul.stack-s", lists.trash.map(row)),
      el("div.row", el("button.danger", { onClick: guarded(empty) }, "Empty the trash")),
    );
  };
  onListsChange(update);
  update();
  return section;
}

/** @param {any} item */
function row(item) {
  const what = item.name;
  const why = item.deleted_by ? `deleted ${formatAgo(item.deleted_at)} by ${item.deleted_by}` : "upload expired";
  const left = (new Date(item.purged_at).getTime() - Date.now()) / 3.6e6;
  const until = left > 0 ? `gone in ${formatHours(left)}` : "gone soon";
  const restore = { "aria-label": `Restore ${what}`, onClick: guarded(() => restoreItem(item, what)) };
  return el("li.spread", [
    el("div.grow", [
      el("p.cut", { title: what }, what),
      el("p.small", [formatBytes(item.size_bytes), why, until].join(" · ")),
    ]),
    el("button", restore, "Restore"),
  ]);
}

/** @param {any} item @param {string} what */
async function restoreItem(item, what) {
  await sendJson("POST", `trash/drives/${item.id}/restore`);
  announce(`${what} is restored.`);
  await refreshLists();
}

async function empty() {
  const text = `What is in it (${lists.trash.length}) is deleted for good. This cannot be undone.`;
  if (!(await confirmAction("Empty the trash?", text, "Empty the trash"))) return;
  await sendJson("DELETE", "trash");
  announce("The trash is empty.");
  await refreshLists();
}

/** @param {() => Promise<void>} action */
const guarded = (action) => () => action().catch(showError);
