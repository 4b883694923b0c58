/** Dialogs: a new map of many drives, the drives of a map. */
import { getConfig, putFile, sendJson } from "../api.js";
import { field, filePicker, iconButton } from "../controls.js";
import { chosenCity, loadMaps, loadMembers } from "../data/city.js";
import { lists } from "../data/lists.js";
import { el, fill, formatAgo } from "../dom.js";
import { attempt, confirmAction, openDialog } from "../messages.js";
import { setState } from "../state.js";

/** @import { City } from "../data/city.js" */

/** Ask for the name of a map, make it, and ask for its drives. */
export function newMap() {
  const name = el("input", { type: "text", required: true, maxLength: 200 });
  const trouble = el("div");
  const make = () =>
    attempt(trouble, async () => {
      const { id } = await sendJson("POST", "maps", { name: name.value.trim() });
      dialog.close();
      await loadMaps();
      setState({ panel: "map", map: id });
      const city = chosenCity();
      if (city) await manageDrives(city);
    });
  const hint = "Of each drive the result that counts is merged: the pinned one, else the best.";
  const cancel = el("button", { type: "button", onClick: () => dialog.close() }, "Cancel");
  const actions = [cancel, el("button.primary", "Make the map")];
  const content = field("Name", name, hint);
  const dialog = openDialog("A new map of many drives", content, { actions, trouble, onSubmit: make });
}

/** @param {City} city */
export async function removeMap({ id, name }) {
  const text = "Its verdicts and the names of its places go for good; its drives stay.";
  if (!(await confirmAction(`Delete the map ${name}?`, text, "Delete the map"))) return;
  await sendJson("DELETE", `maps/${id}`);
  setState({ map: null });
  await loadMaps();
}

/** Show the drives of a map, with why one is not on it; put others in. @param {City} city */
export async function manageDrives(city) {
  const body = el("div.stack-s", "Loading…");
  const trouble = el("div");
  const change = (/** @type {"PUT"|"DELETE"} */ method, /** @type {string} */ drive) =>
    attempt(trouble, async () => {
      await sendJson(method, `maps/${city.id}/drives/${drive}`);
      await Promise.all([show(), loadMaps()]);
    });
  const send = (/** @type {FileList} */ [file]) =>
    attempt(trouble, async () => {
      fill(trouble, el("p.small", { role: "status" }, `Sending ${file.name}…`));
      await putFile(`maps/${city.id}/osm/${encodeURIComponent(file.name)}`, file);
      fill(trouble, el("p.note.good", { role: "status" }, `The map will be compared with ${file.name}.`));
      await loadMaps();
    });
  const show = async () => {
    const members = await loadMembers(city.id);
    const known = new Set(members.map(({ drive_id }) => drive_id));
    const others = lists.drives.filter(({ id, state }) => state === "ready" && !known.has(id));
    const options = others.map((each) => el("option", { value: each.id }, `${each.name} (${madeAt(each.id)})`));
    const choice = el("select.grow", { "aria-label": "Drive to put in" }, options);
    const put = el("button", { type: "button", onClick: () => void change("PUT", choice.value) }, "Put it in");
    const rows = members.map((each) => memberRow(each, () => void change("DELETE", each.drive_id)));
    fill(
      body,
      rows.length ? el("ul.members.scroll", rows) : el("p.quiet", "No drive belongs to it yet."),
      others.length > 0 && el("div.spread", choice, put),
    );
  };
  const accept = getConfig().file_kinds.maps.join(",");
  const about = city.holds_all
    ? "All drives of the server belong to it but those that were taken out."
    : "Drives can belong to several maps.";
  const pick = filePicker("Other OSM file…", (files) => void send(files), { accept, name: "city-osm" });
  const actions = [pick, el("span.grow"), el("button.primary", "Done")];
  openDialog(`Drives of the map ${city.name}`, [el("p.small", about), body], { actions, trouble, kind: "wide" });
  await show();
}

/** @param {string} id @returns {string} When a drive was made: names may repeat. */
const madeAt = (id) => formatAgo(lists.drives.find((each) => each.id === id)?.created_at);

/** @param {import("../data/city.js").Member} member @param {() => void} onOut */
function memberRow({ name, label, job_id, drive_id, problem }, onOut) {
  const called = name ?? label ?? "a deleted drive";
  const waiting = job_id ? "on the map" : "not merged yet: it waits for a result, or for its turn";
  const state = `${madeAt(drive_id)} · ${problem ? `not on the map: ${problem}` : waiting}`;
  return el("li.spread", [
    el("div.grow", el("div.cut", called), el("small", state)),
    iconButton("close", `Take ${called} out of the map`, onOut, "Take it out of the map"),
  ]);
}
