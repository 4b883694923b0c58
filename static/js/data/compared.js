/** The intersections of several jobs of one drive, put together where they are the same. */
import { distanceM } from "./frame.js";

/** @import { Place } from "./results.js" */
/** @typedef {Place & {found: boolean[], outcomes: (string|null)[]}} Compared By which of the jobs it was found, in their order, and with which verdict. */

const GATE_M = 10; // as of the score of the map: farther apart they are two

/**
 * Match one to one, the nearest pairs first; what has no partner in the jobs before is an intersection of its own.
 * @param {Place[][]} sets Intersections of each job.
 * @param {boolean} local Positions are metres of W.
 * @returns {Compared[]} Those of the first job first, in its order.
 */
export function matchIntersections(sets, local) {
  /** @type {Compared[]} */
  const all = [];
  sets.forEach((places, job) => {
    const known = all.length;
    /** @type {{d: number, i: number, k: number}[]} */
    const pairs = [];
    places.forEach((place, k) => {
      for (let i = 0; i < known; i += 1) {
        const d = distanceM(all[i], place, local);
        if (d <= GATE_M) pairs.push({ d, i, k });
      }
    });
    pairs.sort((a, b) => a.d - b.d);
    const matched = new Set();
    for (const { i, k } of pairs) {
      if (matched.has(k) || all[i].found[job]) continue;
      matched.add(k);
      all[i].found[job] = true;
      all[i].outcomes[job] = places[k].properties.outcome ?? null;
    }
    places.forEach((place, k) => {
      if (matched.has(k)) return;
      const found = sets.map((_, each) => each === job);
      all.push({ ...place, found, outcomes: found.map((isIt) => (isIt && place.properties.outcome) || null) });
    });
  });
  return all;
}

/** @param {Compared} item @returns {"shared"|"here"|"elsewhere"} Found by all jobs, by the first but not by all, not by it. */
export function kindOfCompared({ found }) {
  if (found.every(Boolean)) return "shared";
  return found[0] ? "here" : "elsewhere";
}
