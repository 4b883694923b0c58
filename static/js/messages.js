/** Errors, news and questions: as boxes in a panel, floating where no panel asked, or as dialogs. */
import { ApiError, askAgain, onTokenChange } from "./api.js";
import { field, iconButton, inForm } from "./controls.js";
import { el, fill } from "./dom.js";
import { setState } from "./state.js";

const MAX_SHOWN = 20;

/** A box that says what went wrong, in the server's words. @param {unknown} error An error, or a problem document. */
export function problemNote(error) {
  const problem = /** @type {any} */ (error);
  const title = problem.title ?? "Something went wrong";
  const detail = problem.detail ?? problem.message ?? String(error);
  return el("div.note.error", el("strong", title), detail, fileProblems(problem.problems ?? []));
}

/** The same, with a button. @param {unknown} error @param {() => void} again */
export function retryNote(error, again) {
  const isGone = error instanceof ApiError && error.status === 404;
  const retry = el("button", { onClick: () => (askAgain(), again()) }, "Try again");
  return el("div.stack-s", problemNote(error), isGone ? leaveButton() : retry);
}

/** Leads away from a drive or job that does not exist. */
export const leaveButton = () =>
  el("button", { onClick: () => setState({ panel: "drives", drive: null, job: null }) }, "To the drives");

/** @param {import("./api.js").FileProblem[]} problems */
function fileProblems(problems) {
  if (!problems.length) return null;
  const shown = problems.slice(0, MAX_SHOWN).map((each) => el("li", el("code", each.path), " ", inForm(each.message)));
  if (problems.length > shown.length) shown.push(el("li", `and ${problems.length - shown.length} more`));
  return el("ul", shown);
}

/** Show an error that no panel shows. @param {unknown} error */
export function showError(error) {
  if (error instanceof DOMException && error.name === "AbortError") return;
  if (error instanceof Error && !(error instanceof ApiError)) console.error(error);
  toast(problemNote(error), 15000);
}

/** @param {string} text */
export function showMessage(text) {
  toast(el("div.note", text), 4000);
}

/** @param {HTMLElement} note @param {number} ms */
function toast(note, ms) {
  const region = document.getElementById("toasts");
  if (!region) return;
  const told = [...document.querySelectorAll(".note")].filter((each) => each.checkVisibility());
  if (told.some((each) => each.textContent === note.textContent)) return;
  const close = iconButton("close", "Close", () => box.remove(), "");
  const box = el("div.toast", note, close);
  region.append(box);
  setTimeout(() => box.remove(), ms);
}
onTokenChange(() => document.getElementById("toasts")?.replaceChildren()); // of requests without it

/**
 * Do something that may fail, and say in its place what went wrong.
 * @param {Element} trouble
 * @param {() => Promise<any>} work
 * @returns {Promise<boolean>} Whether it was done.
 */
export async function attempt(trouble, work) {
  try {
    fill(trouble);
    await work();
    return true;
  } catch (error) {
    fill(trouble, problemNote(error));
    return false;
  }
}

let dialogs = 0;

/**
 * Open a dialog, to be removed when it is closed. Without buttons below it has one beside its title that closes it.
 *
 * @param {string} title
 * @param {any} content
 * @param {object} [options]
 * @param {any[]} [options.actions] Buttons: one that submits closes the dialog, with its value.
 * @param {HTMLElement} [options.trouble] Stands above the buttons.
 * @param {() => Promise<any>} [options.onSubmit] In the place of closing it; not again while it is at work.
 * @param {(answer: string) => void} [options.onClose] Gets the value of the button that closed it.
 * @param {string} [options.kind] Class.
 * @returns {HTMLDialogElement}
 */
export function openDialog(title, content, { actions, trouble, onSubmit, onClose, kind } = {}) {
  dialogs += 1;
  const heading = el("h2", { id: `dialog-${dialogs}` }, title);
  const close = iconButton("close", "Close", () => dialog.close());
  let isAtWork = false;
  const submit = async (/** @type {Event} */ event) => {
    event.preventDefault();
    if (isAtWork) return;
    isAtWork = true;
    await onSubmit?.().finally(() => (isAtWork = false));
  };
  const form = el("form", { method: "dialog", onSubmit: onSubmit && submit }, [
    el("div.stack.dialog-body", actions ? heading : el("div.spread", heading, close), content),
    trouble,
    actions && el("div.actions.spread", actions),
  ]);
  const leave = (/** @type {Event} */ { target }) => !actions && target === dialog && dialog.close(); // what is around it
  const dialog = el("dialog", { class: kind, "aria-labelledby": heading.id, onClick: leave }, form);
  dialog.addEventListener("close", () => {
    dialog.remove();
    if (document.activeElement === document.body) document.getElementById("panel")?.focus(); // what opened it is gone
    onClose?.(dialog.returnValue);
  });
  document.body.append(dialog);
  dialog.showModal();
  if (actions) dialog.querySelector(/** @type {"input"} */ ("input, select, button"))?.focus(); // not what scrolls
  return dialog;
}

/**
 * Ask yes or no.
 * @param {string} title
 * @param {string} text
 * @param {string} yes The name of the action.
 * @returns {Promise<boolean>}
 */
export function confirmAction(title, text, yes) {
  return new Promise((resolve) => {
    const actions = [el("button", { value: "no" }, "Keep"), el("button.danger", { value: "yes" }, yes)];
    openDialog(title, el("p.quiet", text), { actions, onClose: (answer) => resolve(answer === "yes") });
  });
}

/**
 * Ask for a token, when the server requires one.
 * @param {boolean} wrong Whether a token was refused.
 * @returns {Promise<string|null>} null when the person gave up.
 */
export function askForToken(wrong) {
  return new Promise((resolve) => {
    const pattern = "[ -~]+"; // other characters cannot be sent
    const input = el("input", { type: "password", autocomplete: "off", spellcheck: false, required: true, pattern });
    const refused = "The server refused this token. Was it copied completely, and is it still valid?";
    const hint = "The operator creates one with “interloc admin token add NAME”. It is kept until this tab is closed.";
    const later = el("button", { type: "button", onClick: () => dialog.close("") }, "Not now");
    const content = [wrong && el("p.note.error", refused), field("API token", input, hint)];
    const dialog = openDialog("This server requires a token", content, {
      actions: [later, el("button.primary", { value: "use" }, "Use token")],
      onClose: (answer) => resolve(answer === "use" ? input.value.trim() : null),
    });
  });
}
