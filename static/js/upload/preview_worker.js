/** Web worker: looks what a map has where a drive went, away from the page. */

import { lookIntoMap } from "./osm_roads.js";

self.addEventListener("message", async ({ data: { positions, map, words } }) => {
  self.postMessage(await lookIntoMap(map, positions, words).catch(() => null)); // the service says what is wrong with it
});
