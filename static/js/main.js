/**
 * The page: puts header, panels, map, timeline and drawer together.
 *
 * A panel is a module with `mount(container)`: called once, when the panel is first shown. It keeps itself up to date by
 * `subscribe` (state.js) and leaves for another panel by `setState({panel: "result", job: id})`.
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
 *   later
 *   shell
 *   main
 */
import { loadConfig, onTokenNeeded } from "./api.js";
import { mountDrawer } from "./bev/drawer.js";
import { mount as mountMaps } from "./city/panel.js";
import { el, fill } from "./dom.js";
import { mount as mountDrives } from "./drives/panel.js";
import { mountStage } from "./map/stage.js";
import { askForToken, retryNote, showError } from "./messages.js";
import { mount as mountResult } from "./report/panel.js";
import { mountHeader, mountTabs } from "./shell.js";
import { mountShortcuts } from "./shortcuts.js";
import { setState } from "./state.js";

/** @param {"upload"|"compare"|"exports"} name @returns {(container: HTMLElement) => Promise<void>} Loaded when it is needed. */
const later = (name) => async (container) => {
  const detail = "Is the server reached? After an upgrade, reload the page.";
  const error = { title: "This part of the page could not be loaded", detail };
  const parts = await import("./later.js").catch(() => Promise.reject(error));
  parts[name](container);
};

const PANELS = {
  drives: { title: "Drives", mount: mountDrives },
  upload: { title: "Upload", mount: later("upload") },
  result: { title: "Result", mount: mountResult },
  map: { title: "Map", mount: mountMaps },
  compare: { title: "Compare", tab: "result", mount: later("compare") },
  export: { title: "Export", tab: "result", mount: later("exports") },
};

/** @param {string} id */
const part = (id) => /** @type {HTMLElement} */ (document.getElementById(id));

async function start() {
  onTokenNeeded(askForToken);
  window.addEventListener("unhandledrejection", (event) => (event.preventDefault(), showError(event.reason)));
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
  try {
    await loadConfig();
  } catch (error) {
    const again = () => location.reload();
    return fill(part("panel"), el("div.body", retryNote(error, again)));
  }
  mountHeader(part("header"));
  mountTabs(PANELS);
  document.querySelector(".skip")?.addEventListener("click", (event) => {
    event.preventDefault(); // what stands behind "#" is the state of the page
    part("panel").focus();
  });
  mountDrawer(part("drawer"));
  mountShortcuts(); // the stage may take as long as a live session
  await mountStage();
}

start().catch(showError);
