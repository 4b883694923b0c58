/** The name and the note of a drive or job, edited in a dialog. */
import { sendJson } from "../api.js";
import { field, iconButton } from "../controls.js";
import { el } from "../dom.js";
import { attempt, openDialog } from "../messages.js";

/**
 * @param {string} path Of the drive or job, below the API.
 * @param {any} item The drive or job; a job without a name gets one by itself.
 * @param {string} title Read aloud.
 * @param {(changed: any) => void} onChange
 * @returns {HTMLElement} What begins it.
 */
export function rename(path, item, title, onChange) {
  const edit = () => {
    const isJob = path.startsWith("jobs");
    const more = isJob ? { placeholder: "made from what was asked for" } : { required: true };
    const name = el("input", { type: "text", value: item.name ?? "", maxLength: 200, ...more });
    const note = el("textarea", { rows: 3, maxLength: 2000, value: item.note ?? "" });
    const trouble = el("div", { role: "status" });
    const save = () =>
      attempt(trouble, async () => {
        const changes = { name: name.value.trim() || null, note: note.value.trim() || null };
        const changed = await sendJson("PATCH", path, changes);
        dialog.close();
        onChange(changed);
      });
    const cancel = el("button", { type: "button", onClick: () => dialog.close() }, "Cancel");
    const actions = [cancel, el("button.primary", "Save")];
    const content = [field("Name", name), field("Note", note)];
    const dialog = openDialog(`Rename ${title}`, content, { actions, trouble, onSubmit: save });
    name.select();
  };
  return iconButton("edit", `Rename ${title}`, edit, "Rename it, or note something about it");
}
