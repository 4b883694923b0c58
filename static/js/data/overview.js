/** All drives on one map: their tracks, and the intersections of the result that stands for each. */
import { getJson } from "../api.js";
import { lineOf } from "./results.js";

/**
 * @typedef {object} DriveOnMap
 * @property {string} id
 * @property {string} name
 * @property {string|null} job That stands for it.
 * @property {string|null} title Of that job.
 * @property {"pinned"|"best"|null} chosen Why it does.
 * @property {number[][]} track Longitude, latitude.
 * @property {string|null} verdict How many of its intersections are right, in words.
 * @property {number[][]} intersections
 * @property {string[]} outcomes Of these.
 */
/**
 * @typedef {object} Overview
 * @property {DriveOnMap[]} drives The newest first.
 * @property {number} unplaced How many drives have no georeference.
 * @property {boolean} isCut Whether the server has more drives.
 */

const MAX_DRIVES = 2000;
const PAGE = 250;

/** @returns {Promise<Overview>} */
export async function loadOverview() {
  /** @type {Map<string, DriveOnMap>} */
  const drives = new Map();
  let unplaced = 0;
  for (let after = ""; ; ) {
    const page = await getJson(`overview?limit=${PAGE}${after && `&after=${encodeURIComponent(after)}`}`);
    for (const { geometry, properties } of page.features) {
      const { layer, drive: id, outcomes = [], ...facts } = properties;
      const known = drives.get(id);
      if (layer !== "intersections" && geometry)
        drives.set(id, { ...facts, id, track: lineOf(geometry), intersections: [], outcomes: [] });
      else if (layer !== "intersections") unplaced += 1;
      else if (known) Object.assign(known, { intersections: geometry.coordinates, outcomes });
    }
    if (!page.next || drives.size + unplaced >= MAX_DRIVES)
      return { drives: [...drives.values()], unplaced, isCut: page.next !== null };
    after = page.next;
  }
}
