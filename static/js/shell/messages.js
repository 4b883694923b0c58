/**
 * Errors and news: as boxes in a panel, or floating where no panel asked.
 * @module shell/messages
 */
import { ApiError } from "../api.js";
import { el, icon } from "../dom.js";

/**
 * A box that says what went wrong, in the server's words.
 * @param {unknown} error An error, or a problem document.
 * @param {...any} more Below it: buttons, hints.
 */
export function problemNote(error, ...more) {
  const problem = /** @type {any} */ (error);
  const title = problem.title ?? "Something went wrong";
  const detail = problem.detail ?? problem.message ?? String(error);
  return el(
    "div",
    { class: "note error" },
    el("strong", {}, title),
    detail,
    fileProblems(problem.problems ?? []),
    more,
  );
}

/** @param {Array<import("../api.js").FileProblem>} problems */
export function fileProblems(problems) {
  if (!problems.length) return null;
  const shown = problems.slice(0, 20).map((each) => el("li", {}, el("code", {}, each.path), " ", each.message));
  if (problems.length > shown.length) shown.push(el("li", {}, `and ${problems.length - shown.length} more`));
  return el("ul", {}, shown);
}

/**
 * Show an error that no panel shows.
 * @param {unknown} error
 */
export function showError(error) {
  if (error instanceof DOMException && error.name === "AbortError") return;
  if (error instanceof Error && !(error instanceof ApiError)) console.error(error);
  const note = problemNote(error);
  toast(note, 15000);
}

/** @param {string} text */
export function showMessage(text) {
  toast(el("div", { class: "note" }, text), 4000);
}

/** @param {HTMLElement} note @param {number} ms */
function toast(note, ms) {
  const region = document.getElementById("toasts");
  if (!region) return;
  if ([...region.children].some((other) => other.firstChild?.textContent === note.textContent)) return;
  const close = el(
    "button",
    { class: "plain square", "aria-label": "Close", onClick: () => box.remove() },
    icon("close"),
  );
  const box = el("div", { class: "toast" }, note, close);
  region.append(box);
  setTimeout(() => box.remove(), ms);
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
    const dialog = el(
      "dialog",
      { onClose: () => (dialog.remove(), resolve(dialog.returnValue === "yes")) },
      el(
        "form",
        { method: "dialog" },
        el("h2", {}, title),
        el("p", { class: "quiet" }, text),
        el(
          "div",
          { class: "actions" },
          el("button", { value: "no" }, "Keep"),
          el("button", { class: "danger", value: "yes" }, yes),
        ),
      ),
    );
    document.body.append(dialog);
    dialog.showModal();
  });
}
