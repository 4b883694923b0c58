/**
 * The page: puts header, panels, map, timeline and drawer together.
 *
 * A panel is a module with `mount(container)`: called once, when the panel is first shown. It keeps itself up to date by
 * `subscribe` (state.js) and leaves for another panel by `setState({panel: "job", job: id})`.
 * @module main
 */
import { loadConfig, onTokenNeeded } from "./api.js";
import { mountDrawer } from "./bev/drawer.js";
import { mountStage } from "./map/stage.js";
import { setConfig } from "./shell/config.js";
import { mountHeader } from "./shell/header.js";
import { showError } from "./shell/messages.js";
import { mountTabs } from "./shell/tabs.js";
import { askForToken } from "./shell/token.js";
import { getState, setState, subscribe } from "./state.js";

const PANELS = {
  drives: { title: "Drives", load: () => import("./drives/panel.js") },
  upload: { title: "Upload", load: () => import("./upload/panel.js") },
  job: { title: "Job", load: () => import("./job/panel.js") },
  report: { title: "Report", load: () => import("./report/panel.js") },
  export: { title: "Export", load: () => import("./exports/panel.js") },
};

async function start() {
  onTokenNeeded(askForToken);
  window.addEventListener("unhandledrejection", (event) => showError(event.reason));
  window.addEventListener("dragenter", (event) => {
    if (event.dataTransfer?.types.includes("Files")) setState({ panel: "upload" }); // it takes what is dropped
  });
  setConfig(await loadConfig());
  mountHeader(/** @type {HTMLElement} */ (document.getElementById("header")));
  mountTabs(PANELS);
  document.querySelector(".skip")?.addEventListener("click", (event) => {
    event.preventDefault(); // what stands behind "#" is the state of the page
    document.getElementById("panel")?.focus();
  });
  mountDrawer(/** @type {HTMLElement} */ (document.getElementById("drawer")));
  await mountStage();
  subscribe(["drive", "job"], () => (document.title = getState().job ? "InterLoc – result" : "InterLoc"));
}

start().catch(showError);
