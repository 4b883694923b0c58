/** What panels are made of: fields, choices, buttons, tables. */
import { el, fill, icon } from "./dom.js";

let count = 0;

/** @param {string} title @param {any} control @param {any} [hint] @returns {HTMLElement} */
export function field(title, control, hint) {
  return el("label.field", el("span", title), control, hint && el("small", hint));
}

/**
 * @param {Record<string, string>} choices Value -> text.
 * @param {string} [value]
 * @param {(value: string) => void} [onChange]
 * @param {string} [label] Read aloud, where nothing beside it says what it is.
 * @returns {HTMLSelectElement}
 */
export function select(choices, value, onChange, label) {
  const options = Object.entries(choices).map(([key, text]) => el("option", { value: key }, text));
  const element = el("select", { "aria-label": label, onChange: () => onChange?.(element.value) }, options);
  if (value !== undefined) element.value = value;
  return element;
}

/**
 * Choices of which one holds, each with an explanation.
 *
 * @param {string} legend
 * @param {{value: string, title: any, hint?: any, more?: any}[]} choices `more` is shown where it is chosen.
 * @param {string} value
 * @param {(value: string) => void} [onChange]
 * @returns {{element: HTMLElement, value: () => string}}
 */
export function radios(legend, choices, value, onChange) {
  count += 1;
  const name = `choice-${count}`;
  const rows = choices.map((choice) => {
    const checked = choice.value === value;
    const input = el("input", { type: "radio", name, value: choice.value, checked, onChange: update });
    const more = choice.more && el("div.more", choice.more);
    const text = el("span", choice.title, choice.hint && el("small", choice.hint));
    return { input, more, element: el("div", el("label.check", input, text), more) };
  });
  const chosen = () => rows.find(({ input }) => input.checked)?.input.value ?? "";
  function show() {
    for (const { input, more } of rows) if (more) more.hidden = !input.checked;
  }
  function update() {
    show();
    onChange?.(chosen());
  }
  show();
  const elements = rows.map((row) => row.element);
  return { element: el("fieldset.radios.stack-s", el("legend.field-name", legend), elements), value: chosen };
}

/**
 * A field for a value that a JSON Schema describes; the browser checks it by the schema.
 *
 * @param {any} schema
 * @param {any} value
 * @param {(value: any, isValid: boolean) => void} onChange Gets null where nothing stands in it.
 * @param {(choice: string) => string} [words] For a choice.
 * @returns {any}
 */
export function schemaInput(schema, value, onChange, words = (choice) => choice) {
  const kinds = /** @type {any[]} */ (schema.anyOf ?? [schema]);
  const kind = kinds.find((each) => each.enum || (each.type && each.type !== "null")) ?? {};
  if (kind.enum || kind.type === "boolean") {
    const choices = kind.enum ?? ["true", "false"];
    const texts = kind.enum
      ? Object.fromEntries(choices.map((/** @type {string} */ each) => [each, words(each)]))
      : { true: "yes", false: "no" };
    return select(texts, String(value), (next) => onChange(kind.enum ? next : next === "true", true));
  }
  const mayBeNone = kinds.length > 1 || kind.type === "string";
  const { minimum, maximum, exclusiveMinimum: above, exclusiveMaximum } = kind;
  const bounds = { min: minimum ?? above, max: maximum ?? exclusiveMaximum };
  const ofNumber = { type: "number", ...bounds, step: kind.type === "integer" ? 1 : "any", required: !mayBeNone };
  const ofText = { type: "text", maxLength: kind.maxLength, pattern: kind.pattern };
  const example = schema.examples?.[0];
  const placeholder = example !== undefined ? `As ${example}` : mayBeNone ? "none" : null;
  const props = { ...(kind.type === "string" ? ofText : ofNumber), value: value ?? "", placeholder };
  const input = el("input", props);
  input.addEventListener("input", () => {
    const text = input.value.trim();
    const next = text === "" ? null : kind.type === "string" ? text : Number(text);
    const tooSmall = next !== null && above !== undefined && next <= above;
    input.setCustomValidity(tooSmall ? `More than ${above} was expected.` : "");
    onChange(next, input.validity.valid);
  });
  return input;
}

/**
 * A button that lets a person pick files.
 *
 * @param {any} content Of the button.
 * @param {(files: FileList) => void} onPick
 * @param {{accept?: string, multiple?: boolean, folder?: boolean, name?: string, class?: string}} [options] `name`: of
 *   the input, for tests.
 */
export function filePicker(content, onPick, { accept, multiple, folder, name, class: kind } = {}) {
  const input = el("input", { type: "file", accept, multiple, hidden: true, name, webkitdirectory: folder || null });
  input.addEventListener("change", () => {
    if (input.files.length) onPick(input.files);
    input.value = ""; // the same file may be picked again
  });
  const button = el("button", { type: "button", class: kind, onClick: () => input.click() }, content);
  return el("span", button, input);
}

/**
 * @param {string} symbol Of `icons.svg`.
 * @param {string} label Read aloud.
 * @param {(event: Event) => void} onClick
 * @param {string} [title] Shown under the pointer.
 */
export function iconButton(symbol, label, onClick, title = label) {
  const props = { type: "button", class: "square plain", title, "aria-label": label, onClick };
  return el("button", props, icon(symbol));
}

/** A button that copies a text. @param {string} name @param {() => string} text */
export function copyButton(name, text) {
  const button = el("button", { type: "button", onClick: () => void copy() }, icon("copy"), name);
  const copy = async () => {
    try {
      await navigator.clipboard.writeText(text());
    } catch {
      const area = el("textarea.unseen", { value: text() }); // plain http has no clipboard of its own
      document.body.append(area);
      area.select();
      document.execCommand("copy");
      area.remove();
    }
    fill(button, icon("check"), "Copied");
    setTimeout(() => fill(button, icon("copy"), name), 1500);
  };
  return button;
}

/** @param {string} title @param {...any} children */
export function section(title, ...children) {
  return el("section.stack-s", el("h3", title), children);
}

/** A part of a result, with room above it. @param {string} title @param {...any} children */
export const resultSection = (title, ...children) => el("section.section", el("h3", title), children);

/**
 * Names and values, for a `dl`.
 * @param {(([name: any, value: any])|null|undefined|false|0|"")[]} facts
 * @returns {HTMLElement[][]}
 */
export function factRows(facts) {
  return facts.flatMap((fact) => (fact ? [[el("dt", fact[0]), el("dd", fact[1])]] : []));
}

/** Names and values below each other. @param {string} kind Classes. @param {Parameters<typeof factRows>[0]} facts */
export const factList = (kind, facts) => el("dl.figures", { class: kind }, factRows(facts));

/** @param {any[]} texts */
export const bullets = (texts) => el("ul.reasons", [texts.map((each) => el("li", each))]);

/** A link to another site, in a tab of its own. @param {string} href @param {string} text @param {object} [props] */
export const outLink = (href, text, props) => el("a", { href, target: "_blank", rel: "noopener", ...props }, text);

/** Says that something takes a moment. @param {string} text */
export const busy = (text) =>
  el("div", el("p.small", { role: "status" }, text), el("progress", { "aria-label": text }));

/** A figure in large. @param {string} value @param {string} name @param {string} [more] */
export function figure(value, name, more) {
  return el("div.figure.box", el("b", value), el("span", name), more && el("em", more));
}

/** @param {string[]} heads @param {any[][]} rows Cells: `td` elements, or what goes into one. @returns {HTMLElement} */
export function table(heads, rows) {
  const head = heads.map((name) => el("th", { scope: "col" }, name));
  const body = rows.map((cells) =>
    el(
      "tr",
      cells.map((cell) => (cell instanceof HTMLTableCellElement ? cell : el("td", cell))),
    ),
  );
  return el("table", el("thead", el("tr", head)), el("tbody", body));
}

const SEVERITIES = /** @type {Record<string, string>} */ ({ error: "Error", warning: "Warning", note: "Note" });

/** What the form of a drive calls options; one that is not here is asked for elsewhere. */
export const OPTIONS = /** @type {Record<string, string>} */ ({
  label_scheme: "What the ids of labels mean",
  pose_frame: "Poses are those of",
  layout: "Layout",
  points: "Topic of the scans",
  fix: "Topic of the GNSS fixes",
  crs: "Coordinate system of LAS files",
  poses: "Poses",
  frames: "Part of the drive",
  deskew: "Motion within scans",
});

/** A text of the server: where the command line has an option, the form has a field. @param {string} text */
export const inForm = (text) =>
  text.replace(/`[^`]*`|--([a-z-]+)/g, (found, name = "") => {
    const title = /** @type {typeof OPTIONS} */ ({ ...OPTIONS, labels: "Labels" })[name.replace("-", "_")];
    return title ? `“${title}”` : found;
  });

/** @param {import("./api.js").FileProblem[]} problems @returns {HTMLElement | null} */
export function problemList(problems) {
  if (!problems.length) return null;
  const items = problems.map(({ severity, path, message }) => {
    const title = el("strong", SEVERITIES[severity] ?? severity);
    return el("li.note.small", { class: severity }, title, el("code", path), " ", inForm(message));
  });
  return el("ul.stack-s", items);
}
