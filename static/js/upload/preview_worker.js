/** Web worker: reads where a drive went and what the map has there, away from the page. */

import { isReadableMap, lookIntoMap } from "./osm_roads.js";
import { readTrack } from "./track.js";

self.addEventListener("message", async ({ data: { files, map, words } }) => {
  const track = await readTrack(files).catch(() => null); // what is wrong with the files, the service says
  self.postMessage({ track, isDone: !map });
  if (!map) return;
  const canLook = track && !track.local && isReadableMap(map.name);
  const look = canLook ? await lookIntoMap(map, track.scans, words).catch(() => null) : null;
  self.postMessage({ track, look, isDone: true });
});
