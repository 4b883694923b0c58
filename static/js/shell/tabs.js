/**
 * The tabs of the left panel: the steps from a drive to its files. Panels are loaded when they are first shown.
 * @module shell/tabs
 */
import { el, fill } from "../dom.js";
import { getState, setState, subscribe } from "../state.js";
import { problemNote } from "./messages.js";

/** @param {Record<string, {title: string, load: () => Promise<{mount: (container: HTMLElement) => void}>}>} panels */
export function mountTabs(panels) {
  const list = /** @type {HTMLElement} */ (document.getElementById("tabs"));
  const panel = /** @type {HTMLElement} */ (document.getElementById("panel"));
  const names = Object.keys(panels);
  /** @type {Record<string, HTMLElement>} */
  const bodies = {};
  const tabs = names.map((name) =>
    el(
      "button",
      { role: "tab", id: `tab-${name}`, "aria-controls": `panel-${name}`, onClick: () => setState({ panel: name }) },
      panels[name].title,
    ),
  );
  fill(list, tabs);
  list.addEventListener("keydown", (event) => {
    const step = { ArrowRight: 1, ArrowLeft: -1 }[event.key];
    if (!step) return;
    const usable = names.filter((_, i) => !tabs[i].disabled);
    const next = usable[(usable.indexOf(shown()) + step + usable.length) % usable.length];
    setState({ panel: next });
    document.getElementById(`tab-${next}`)?.focus();
    event.preventDefault();
  });

  const shown = () => (names.includes(getState().panel) ? getState().panel : names[0]);
  const update = () => {
    const current = shown();
    const leaves = Object.entries(bodies).some(
      ([name, body]) => name !== current && body.contains(document.activeElement),
    );
    names.forEach((name, i) => {
      const needsJob = name === "job" || name === "report" || name === "export";
      tabs[i].disabled = needsJob && !getState().job && name !== current;
      tabs[i].setAttribute("aria-selected", String(name === current));
      tabs[i].tabIndex = name === current ? 0 : -1;
      if (bodies[name]) bodies[name].hidden = name !== current;
    });
    if (!bodies[current]) {
      const body = el("div", {
        role: "tabpanel",
        id: `panel-${current}`,
        "aria-labelledby": `tab-${current}`,
        class: "body",
      });
      bodies[current] = body;
      panel.append(body);
      panels[current].load().then(
        (module) => module.mount(body),
        (error) => fill(body, problemNote(error)),
      );
    }
    if (leaves) panel.focus(); // what had the focus is hidden now
    panel.scrollTop = 0;
  };
  subscribe(["panel", "job"], update);
  update();
}
