/**
 * The page: puts header, panels, map, timeline and drawer together.
 *
 * A panel is a module with `mount(container)`: called once, when the panel is first shown. It keeps itself up to date by
 * `subscribe` (state.js) and leaves for another panel by `setState({panel: "job", job: id})`.
 *
 * Layers, the lowest first; a module imports from its own folder and from lines above its own, no others:
 *   dom  leaflet  news  storage
 *   state
 *   api  controls
 *   messages  data
 *   shortcuts
 *   map  job
 *   city
 *   bev  drives  exports  report  upload
 *   shell
 *   main
 */
import { loadConfig, onTokenNeeded } from "./api.js";
import { mountDrawer } from "./bev/drawer.js";
import { mountStage } from "./map/stage.js";
import { askForToken, showError } from "./messages.js";
import { mountHeader, mountTabs } from "./shell.js";
import { mountShortcuts } from "./shortcuts.js";
import { setState } from "./state.js";

const PANELS = {
  drives: { title: "Drives", load: () => import("./drives/panel.js") },
  map: { title: "Map", load: () => import("./city/panel.js") },
  upload: { title: "Upload", load: () => import("./upload/panel.js") },
  job: { title: "Job", load: () => import("./job/panel.js") },
  report: { title: "Report", load: () => import("./report/panel.js") },
  compare: { title: "Compare", load: () => import("./report/comparison.js") },
  export: { title: "Export", load: () => import("./exports/panel.js") },
};

/** @param {string} id */
const part = (id) => /** @type {HTMLElement} */ (document.getElementById(id));

async function start() {
  onTokenNeeded(askForToken);
  window.addEventListener("unhandledrejection", (event) => showError(event.reason));
  const hasFiles = (/** @type {DragEvent} */ event) => event.dataTransfer?.types.includes("Files");
  window.addEventListener("dragenter", (event) => {
    if (hasFiles(event)) setState({ panel: "upload" }); // it takes what is dropped
  });
  for (const kind of ["dragover", "drop"]) {
    window.addEventListener(kind, (event) => {
      // Also before that panel is loaded: without this there is no drop, and the browser leaves the page for the file.
      if (hasFiles(/** @type {DragEvent} */ (event))) event.preventDefault();
    });
  }
  await loadConfig();
  mountHeader(part("header"));
  mountTabs(PANELS);
  document.querySelector(".skip")?.addEventListener("click", (event) => {
    event.preventDefault(); // what stands behind "#" is the state of the page
    part("panel").focus();
  });
  mountDrawer(part("drawer"));
  await mountStage();
  mountShortcuts();
}

start().catch(showError);
