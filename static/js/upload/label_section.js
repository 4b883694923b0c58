/** The part of the form about labels: which folders are sent, and what their ids mean. */

import { el, fill, formatPercent, plural } from "../dom.js";
import { field, filePicker, section, select } from "./controls.js";
import { LABEL_FOLDERS, SCHEMES } from "./words.js";

/**
 * @param {import("./upload.js").Settings | null} before
 * @param {boolean} isUnknown The folders are not known yet, as those of an archive.
 * @param {{onChange: () => void, onFolder: (files: FileList) => void}} listeners `onFolder`: predictions from elsewhere.
 */
export function labelSection(before, isUnknown, { onChange, onFolder }) {
  const rows = el("div", { class: "stack-s" });
  /** @type {Map<string, HTMLInputElement>} */
  const boxes = new Map();
  const chosen = before?.options.label_scheme ?? "auto";
  const isCustom = !(chosen in SCHEMES);
  const ids = el("input", {
    type: "text",
    placeholder: "40, 60",
    value: isCustom ? chosen : "",
    "aria-label": "Ids of road",
    hidden: !isCustom,
    onInput: onChange,
  });
  const scheme = select(SCHEMES, isCustom ? "custom" : chosen, (value) => {
    ids.hidden = value !== "custom";
    onChange();
  });
  const verdict = el("small", {});
  const picker = filePicker("Predictions from another folder …", onFolder, {
    folder: true,
    class: "link",
    name: "prediction-folder",
  });

  return {
    element: section(
      "Labels",
      !isUnknown && [rows, el("div", {}, picker)],
      el("div", { class: "stack-s" }, field("What their ids mean", scheme), ids, verdict),
    ),

    /** @param {Record<string, import("./numbered.js").NumberedFiles>} folders */
    setFolders(folders) {
      const names = Object.keys(folders);
      const wasOff = new Set([...boxes].filter(([, box]) => !box.checked).map(([name]) => name));
      boxes.clear();
      fill(
        rows,
        names.map((name) => {
          const isOn = before ? before.folders.includes(name) || !boxes.size : !wasOff.has(name);
          const box = el("input", {
            type: "checkbox",
            checked: isOn || names.length === 1,
            disabled: names.length === 1,
            onChange,
          });
          boxes.set(name, box);
          const title = LABEL_FOLDERS[/** @type {keyof typeof LABEL_FOLDERS} */ (name)];
          const count = plural(folders[name].files.size, "file");
          if (names.length === 1) return el("p", {}, `${title}, ${count}`);
          return el("label", { class: "check" }, box, el("span", {}, title, el("small", {}, count)));
        }),
        !names.length && el("p", { class: "quiet" }, "None in the folder."),
      );
    },

    folders: () => [...boxes].filter(([, box]) => box.checked).map(([name]) => name),
    scheme: () => (scheme.value === "custom" ? ids.value.trim() || "custom" : scheme.value),

    /** @param {[string, import("./schemes.js").Judgement][]} judged */
    setVerdict(judged) {
      verdict.textContent = judged
        .map(
          ([folder, { scheme: found, roadShare }]) =>
            `${folder}: read as ${found.name === "custom" ? "given" : found.name}, ${formatPercent(roadShare)} road.`,
        )
        .join(" ");
    },
  };
}
