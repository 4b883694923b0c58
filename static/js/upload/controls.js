/** Small controls that the sections of the form are made of. */

import { el } from "../dom.js";

let count = 0;

/** @param {string} prefix */
export function newId(prefix) {
  count += 1;
  return `${prefix}-${count}`;
}

/**
 * @param {string} title
 * @param {any} control
 * @param {any} [hint]
 */
export function field(title, control, hint) {
  return el("label", { class: "field" }, el("span", {}, title), control, hint && el("small", {}, hint));
}

/**
 * @param {Record<string, string>} choices Value -> text.
 * @param {string} value
 * @param {(value: string) => void} [onChange]
 * @returns {HTMLSelectElement}
 */
export function select(choices, value, onChange) {
  const options = Object.entries(choices).map(([key, text]) => el("option", { value: key }, text));
  const element = el("select", { onChange: () => onChange?.(element.value) }, options);
  element.value = value;
  return element;
}

/**
 * Choices of which one holds, each with an explanation.
 *
 * @param {string} legend
 * @param {{value: string, title: any, hint?: any, more?: any}[]} choices `more` is shown where it is chosen.
 * @param {string} value
 * @param {(value: string) => void} [onChange]
 * @returns {{element: HTMLElement, value: () => string, choose: (value: string) => void}}
 */
export function radios(legend, choices, value, onChange) {
  const name = newId("choice");
  const rows = choices.map((choice) => {
    const input = el("input", {
      type: "radio",
      name,
      value: choice.value,
      checked: choice.value === value,
      onChange: update,
    });
    const more = choice.more && el("div", { class: "more" }, choice.more);
    const text = el("span", {}, choice.title, choice.hint && el("small", {}, choice.hint));
    return { choice, input, more, element: el("div", {}, el("label", { class: "check" }, input, text), more) };
  });
  const chosen = () => rows.find(({ input }) => input.checked)?.choice.value ?? "";
  function show() {
    for (const { input, more } of rows) if (more) more.hidden = !input.checked;
  }
  function update() {
    show();
    onChange?.(chosen());
  }
  show();
  const element = el(
    "fieldset",
    { class: "radios" },
    el("legend", { class: "field-name" }, legend),
    rows.map((row) => row.element),
  );
  return {
    element,
    value: chosen,
    choose: (wanted) => {
      for (const { choice, input } of rows) input.checked = choice.value === wanted;
      show();
    },
  };
}

/**
 * A button that lets a person pick files.
 *
 * @param {any} content Of the button.
 * @param {(files: FileList) => void} onPick
 * @param {{accept?: string, multiple?: boolean, folder?: boolean, name?: string, class?: string}} [options] `name`: of the input, for tests.
 */
export function filePicker(content, onPick, { accept, multiple, folder, name, class: kind } = {}) {
  const input = el("input", { type: "file", accept, multiple, hidden: true, name, webkitdirectory: folder || null });
  input.addEventListener("change", () => {
    if (input.files.length) onPick(input.files);
    input.value = ""; // the same file may be picked again
  });
  return el("span", {}, el("button", { type: "button", class: kind, onClick: () => input.click() }, content), input);
}

/** @param {string} title @param {...any} children */
export function section(title, ...children) {
  return el("section", { class: "stack-s" }, el("h3", {}, title), children);
}

/** @param {import("./numbered.js").FileProblem[]} problems @returns {HTMLElement | null} */
export function problemList(problems) {
  if (!problems.length) return null;
  const words = { error: "Error", warning: "Warning", note: "Note" };
  return el(
    "ul",
    { class: "problems" },
    problems.map(({ severity, path, message }) =>
      el(
        "li",
        { class: `is-${severity}` },
        el("span", { class: "severity" }, words[severity] ?? severity),
        el("span", {}, el("code", {}, path), " ", message),
      ),
    ),
  );
}
