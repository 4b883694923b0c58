/** The first view: pick or drop a drive, or go on with an upload that was begun. */

import { el, formatAgo, formatBytes, icon, plural } from "../dom.js";
import { filePicker } from "./controls.js";
import { canPickHandles } from "./folder.js";
import { EXAMPLE } from "./words.js";

/**
 * @param {object} actions
 * @param {(list: FileList) => void} actions.onFolder
 * @param {(handle: FileSystemDirectoryHandle) => void} actions.onHandle
 * @param {(file: File) => void} actions.onArchive
 * @param {(upload: import("./memory.js").Remembered) => void} actions.onContinue
 * @param {(upload: import("./memory.js").Remembered) => void} actions.onForget
 * @param {{upload: import("./panel.js").Open, hasHandle: boolean}[]} begun Uploads that were begun.
 * @param {any} message What happened to the last try.
 */
export function startView({ onFolder, onHandle, onArchive, onContinue, onForget }, begun, message) {
  const input = el("input", { type: "file", name: "folder", webkitdirectory: true, hidden: true });
  input.addEventListener("change", () => input.files.length && onFolder(input.files));
  const pick = async () => {
    if (!canPickHandles()) {
      input.click();
      return;
    }
    const handle = await window.showDirectoryPicker({ id: "drive", mode: "read" }).catch((error) => {
      if (error.name === "AbortError") return null; // the person changed their mind
      throw error;
    });
    if (handle) onHandle(handle);
  };
  const zone = el(
    "div",
    { class: "drop" },
    icon("upload"),
    el(
      "p",
      {},
      el("strong", {}, "Drop the folder of a drive here"),
      el("br"),
      el("span", { class: "quiet" }, "or an archive: .zip, .tar, .tar.gz, .tar.zst"),
    ),
    el(
      "div",
      { class: "row" },
      el("button", { class: "primary", onClick: pick }, "Choose a folder"),
      filePicker("Choose an archive", ([file]) => onArchive(file), {
        accept: ".zip,.tar,.tgz,.gz,.zst,.tzst",
        name: "archive",
      }),
    ),
    input,
  );
  return el(
    "div",
    { class: "stack" },
    el("h2", {}, "Upload a drive"),
    message,
    zone,
    el(
      "p",
      { class: "small" },
      "Nothing is sent before you say so. Scans are reduced to their ground points in the browser, so that a drive of 11 GB becomes some hundred MB.",
    ),
    begun.length > 0 &&
      el(
        "section",
        { class: "stack-s" },
        el("h3", {}, "Uploads that were begun"),
        begun.map(({ upload, hasHandle }) =>
          el(
            "div",
            { class: "box spread" },
            el(
              "div",
              { class: "cut" },
              el("strong", { class: "cut" }, upload.name),
              el("br"),
              el(
                "small",
                {},
                formatAgo(upload.at),
                upload.arrived &&
                  ` · ${plural(upload.arrived.files, "file")} there, ${formatBytes(upload.arrived.size_bytes)}`,
              ),
            ),
            hasHandle
              ? el("button", { onClick: () => onContinue(upload) }, "Continue")
              : el("button", { onClick: () => input.click() }, "Pick it again"),
            el(
              "button",
              {
                class: "plain square",
                title: "Remove it from the service",
                "aria-label": `Remove ${upload.name}`,
                onClick: () => onForget(upload),
              },
              icon("trash"),
            ),
          ),
        ),
      ),
    el("details", {}, el("summary", {}, "What a drive looks like"), el("pre", { class: "code" }, EXAMPLE)),
  );
}
