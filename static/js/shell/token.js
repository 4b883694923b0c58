/**
 * The question for a token, when the server wants one.
 * @module shell/token
 */
import { el } from "../dom.js";

/**
 * @param {boolean} wrong Whether a token was refused.
 * @returns {Promise<string|null>} null when the person gave up.
 */
export function askForToken(wrong) {
  return new Promise((resolve) => {
    const input = el("input", { type: "password", autocomplete: "off", spellcheck: false, required: true });
    const dialog = el(
      "dialog",
      {
        onClose: () => {
          dialog.remove();
          resolve(dialog.returnValue === "use" ? input.value.trim() : null);
        },
      },
      el(
        "form",
        { method: "dialog", class: "stack" },
        el("h2", {}, "This server wants a token"),
        wrong &&
          el(
            "p",
            { class: "note error" },
            "The server refused this token. Was it copied whole, and is it still valid?",
          ),
        el(
          "label",
          { class: "field" },
          el("span", {}, "API token"),
          input,
          el(
            "small",
            {},
            "Its operator makes one with “interloc token add NAME”. It is kept until this tab is closed.",
          ),
        ),
        el(
          "div",
          { class: "actions" },
          el("button", { type: "button", onClick: () => dialog.close("") }, "Not now"),
          el("button", { class: "primary", value: "use" }, "Use token"),
        ),
      ),
    );
    document.body.append(dialog);
    dialog.showModal();
    input.focus();
  });
}
