/** The name and the note of a drive or job, edited in their place. */
import { sendJson } from "../api.js";
import { field, iconButton } from "../controls.js";
import { el, fill } from "../dom.js";
import { attempt } from "../messages.js";

/**
 * @param {object} thing
 * @param {string} thing.path Of the drive or job, below the API.
 * @param {any} thing.item The drive or job.
 * @param {HTMLElement} thing.heading Shown while it is not edited.
 * @param {string} thing.title Read aloud.
 * @param {boolean} thing.mayBeUnnamed It then gets a name by itself.
 * @param {(changed: any) => void} thing.onChange
 * @returns {{button: HTMLElement, element: HTMLElement}} What begins it, and where it happens.
 */
export function naming({ path, item, heading, title, mayBeUnnamed, onChange }) {
  const element = el("div.naming.grow");
  const button = iconButton("edit", `Rename ${title}`, edit, "Rename it, or note something about it");

  function show() {
    fill(element, heading, item.note && el("p.small.noted", item.note));
  }

  function edit() {
    const more = mayBeUnnamed ? { placeholder: "made from what was asked for" } : { required: true };
    const name = el("input", { type: "text", value: item.name ?? "", maxLength: 200, ...more });
    const note = el("textarea", { rows: 3, maxLength: 2000, value: item.note ?? "" });
    const trouble = el("div", { role: "status" });
    const close = () => {
      show();
      button.focus();
    };
    const save = () =>
      attempt(trouble, async () => {
        const changes = { name: name.value.trim() || null, note: note.value.trim() || null };
        const changed = await sendJson("PATCH", path, changes);
        close();
        onChange(changed);
      });
    const onKeydown = (/** @type {KeyboardEvent} */ event) => {
      if (event.key !== "Escape") return;
      event.stopPropagation();
      close();
    };
    const onSubmit = (/** @type {Event} */ event) => (event.preventDefault(), void save());
    const form = el("form.stack-s.editing", { onSubmit, onKeydown }, [
      field("Name", name),
      field("Note", note),
      trouble,
      el("div.row", el("button.primary", "Save"), el("button", { type: "button", onClick: close }, "Cancel")),
    ]);
    fill(element, form);
    name.focus();
    name.select();
  }

  show();
  return { button, element };
}

/** @param {Element} container @returns {boolean} Whether something in it is being edited: it should not be drawn anew. */
export const isEditing = (container) => container.querySelector("form.editing") !== null;
