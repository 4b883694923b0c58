/** Dialogs: a new map of many drives, the drives of a map, the maps of a drive. */
import { getConfig, putFile, sendJson } from "../api.js";
import { field, filePicker, iconButton, openDialog } from "../controls.js";
import { cities, loadMaps, loadMembers } from "../data/city.js";
import { lists } from "../data/lists.js";
import { el, fill } from "../dom.js";
import { confirmAction, problemNote } from "../messages.js";
import { setState } from "../state.js";

/** @typedef {import("../data/city.js").City} City */

const PAGE = 100;

/** Ask for the name and the drives of a map, and make it. @param {string[]} [chosen] Ids of drives. */
export function newMap(chosen = []) {
  const name = el("input", { type: "text", required: true, maxLength: 200 });
  const boxes = lists.drives
    .filter(({ state }) => state === "ready")
    .map((drive) =>
      el("input", { type: "checkbox", value: drive.id, checked: chosen.includes(drive.id), title: drive.name }),
    );
  const trouble = el("div");
  const make = async (/** @type {Event} */ event) => {
    event.preventDefault();
    const drives = boxes.filter((box) => box.checked).map((box) => box.value);
    try {
      const made = await sendJson("POST", "maps", { name: name.value.trim(), drives });
      dialog.close();
      await loadMaps();
      setState({ panel: "map", map: made.id });
    } catch (error) {
      fill(trouble, problemNote(error));
    }
  };
  const none = "There are none yet: upload drives first, or put them into the map later.";
  const form = el("form.stack", { onSubmit: make }, [
    el("h2", { id: "city-title" }, "A new map of many drives"),
    field("Name", name),
    el("fieldset.stack-s", [
      el("legend.field-name", "Its drives"),
      boxes.length
        ? el(
            "div.scroll.picks",
            boxes.map((box) => el("label.check", box, el("span.cut", box.title))),
          )
        : el("p.small", none),
      el("small", "Of each drive the result that counts is merged: the pinned one, else the best."),
    ]),
    trouble,
    el("div.actions", [
      el("button", { type: "button", onClick: () => dialog.close() }, "Cancel"),
      el("button.primary", "Make the map"),
    ]),
  ]);
  const dialog = openDialog({ "aria-labelledby": "city-title" }, [form]);
  name.focus();
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
  let room = PAGE;
  const change = async (/** @type {"PUT"|"DELETE"} */ method, /** @type {string} */ drive) => {
    fill(trouble);
    try {
      await sendJson(method, `maps/${city.id}/drives/${drive}`);
      await Promise.all([show(), loadMaps()]);
    } catch (error) {
      fill(trouble, problemNote(error));
    }
  };
  const send = async (/** @type {FileList} */ [file]) => {
    fill(trouble, el("p.small", { role: "status" }, `Sending ${file.name}…`));
    try {
      await putFile(`maps/${city.id}/osm/${encodeURIComponent(file.name)}`, file);
      fill(trouble, el("p.note.good", { role: "status" }, `The map will be compared with ${file.name}.`));
      await loadMaps();
    } catch (error) {
      fill(trouble, problemNote(error));
    }
  };
  const show = async () => {
    const members = await loadMembers(city.id);
    const known = new Set(members.map(({ drive_id }) => drive_id));
    const others = lists.drives.filter(({ id, state }) => state === "ready" && !known.has(id));
    const options = others.map(({ id, name }) => el("option", { value: id }, name));
    const choice = el(
      "select",
      { "aria-label": "Drive to put in", onChange: () => choice.value && void change("PUT", choice.value) },
      [el("option", { value: "" }, "Put a drive in…"), options],
    );
    const rows = members.slice(0, room).map((each) => memberRow(each, () => void change("DELETE", each.drive_id)));
    const more = () => ((room += PAGE), void show());
    fill(
      body,
      rows.length ? el("ul.members", rows) : el("p.quiet", "No drive belongs to it yet."),
      members.length > room && el("button", { type: "button", onClick: more }, `Show more (${members.length - room})`),
      others.length > 0 && choice,
    );
  };
  const accept = getConfig().file_kinds.maps.join(",");
  openDialog({ class: "tall", "aria-labelledby": "city-title" }, [
    el("form", { method: "dialog" }, [
      el("div.tall-body.stack-s", [
        el("h2", { id: "city-title" }, `Drives of the map ${city.name}`),
        el(
          "p.small",
          city.holds_all
            ? "All drives of the server belong to it but those that were taken out."
            : "Drives can belong to several maps.",
        ),
        body,
        trouble,
      ]),
      el("div.actions", [
        filePicker("Other OSM file…", (files) => void send(files), { accept, name: "city-osm" }),
        el("span.grow"),
        el("button.primary", "Done"),
      ]),
    ]),
  ]);
  await show();
}

/** @param {import("../data/city.js").Member} member @param {() => void} onOut */
function memberRow({ name, label, job_id, problem }, onOut) {
  const called = name ?? label ?? "a deleted drive";
  const state = problem ?? (job_id ? "on the map" : "not merged yet: it waits for a result, or for its turn");
  return el("li.spread", [
    el("div.grow", el("div.cut", called), el("small", { class: problem ? "failed" : "" }, state)),
    iconButton("close", `Take ${called} out of the map`, onOut, "Take it out of the map"),
  ]);
}

/** Say to which maps a drive belongs, and change it. @param {any} drive */
export async function mapsOfDrive(drive) {
  await loadMaps();
  const trouble = el("div");
  const row = async (/** @type {City} */ city) => {
    const member = (await loadMembers(city.id)).find(({ drive_id }) => drive_id === drive.id);
    const box = el("input", { type: "checkbox", checked: member !== undefined });
    const state = el("small", member?.problem ?? (member?.job_id ? "on the map" : member ? "waits for a result" : ""));
    box.addEventListener("change", async () => {
      fill(trouble);
      try {
        await sendJson(box.checked ? "PUT" : "DELETE", `maps/${city.id}/drives/${drive.id}`);
        fill(state, box.checked ? "will be merged" : "will be taken out");
        await loadMaps();
      } catch (error) {
        box.checked = !box.checked;
        fill(trouble, problemNote(error));
      }
    });
    return el("label.check", box, el("span", city.name, " ", state));
  };
  const rows = await Promise.all((cities.maps ?? []).map(row));
  const make = () => (dialog.close(), newMap([drive.id]));
  const form = el("form.stack", { method: "dialog" }, [
    el("h2", { id: "city-title" }, `Maps that hold ${drive.name}`),
    el("div.stack-s", rows),
    trouble,
    el("div.actions", el("button", { type: "button", onClick: make }, "New map…"), el("button.primary", "Done")),
  ]);
  const dialog = openDialog({ "aria-labelledby": "city-title" }, [form]);
}
