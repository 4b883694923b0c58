/** What was deleted and can be restored: below the drives, shown while there is anything. */
import { getJson, keepLooking, sendJson } from "../api.js";
import { lists, onListsChange, refreshLists } from "../data/lists.js";
import { announce, el, fill, formatAgo, formatBytes } from "../dom.js";
import { formatHours } from "../job/words.js";
import { confirmAction, showError } from "../messages.js";
import { getState, subscribe } from "../state.js";

const LOOK_MS = 10000; // between looks for what others have deleted

/** @returns {HTMLElement} */
export function trashSection() {
  const summary = el("summary");
  const body = el("div.stack-s");
  const section = el("details.section.trash", { hidden: true }, summary, body);
  let said = "[]";
  const look = async () => {
    if (getState().panel !== "drives") return;
    const { items } = await getJson("trash?limit=1000");
    if (JSON.stringify(items) === said) return;
    said = JSON.stringify(items);
    section.hidden = !items.length;
    fill(summary, `Trash (${items.length})`);
    const drop = el("button.danger", { onClick: () => empty(items.length).then(look, showError) }, "Empty the trash");
    fill(body, el("ul.stack-s", items.map(row)), el("div.row", drop));
  };
  let drives = "";
  onListsChange(() => {
    const now = lists.drives.map(({ id }) => id).join();
    if (lists.isWhole && now !== drives) void look().catch(() => {}); // one may have gone into it
    if (lists.isWhole) drives = now;
  });
  subscribe(["panel"], () => void look().catch(() => {})); // the lists say what is wrong
  keepLooking(LOOK_MS, look);
  return section;
}

/** @param {any} item */
function row(item) {
  const what = item.name;
  const why = item.deleted_by ? `deleted ${formatAgo(item.deleted_at)} by ${item.deleted_by}` : "upload expired";
  const left = (new Date(item.purged_at).getTime() - Date.now()) / 3.6e6;
  const until = left > 0 ? `gone in ${formatHours(left)}` : "gone soon";
  const restore = async () => {
    await sendJson("POST", `trash/drives/${item.id}/restore`);
    announce(`${what} is restored.`);
    await refreshLists();
  };
  return el("li.spread", [
    el("div.grow", [
      el("p.cut", { title: what }, what),
      el("p.small", [formatBytes(item.size_bytes), why, until].join(" · ")),
    ]),
    el("button", { "aria-label": `Restore ${what}`, onClick: () => restore().catch(showError) }, "Restore"),
  ]);
}

/** @param {number} count */
async function empty(count) {
  const text = `What is in it (${count}) is deleted for good. This cannot be undone.`;
  if (!(await confirmAction("Empty the trash?", text, "Empty the trash"))) return;
  await sendJson("DELETE", "trash");
  announce("The trash is empty.");
}
