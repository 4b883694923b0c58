import assert from "node:assert/strict";
import { test } from "node:test";

import { kindOfCompared, matchIntersections } from "../../../static/js/data/compared.js";
import { flatten } from "../../../static/js/data/lists.js";
import { nest } from "../../../static/js/job/job_form.js";
import { freeName } from "../../../static/js/job/run_dialog.js";

/** @param {number[]} xs Metres. */
const places = (...xs) => xs.map((lng) => ({ lng, lat: 0, properties: {} }));

test("intersections of jobs are the same within ten metres, one to one and the nearest first", () => {
  const all = matchIntersections([places(0, 100), places(9, 2, 300), places(301, 100)], true);
  assert.deepEqual(
    all.map(({ lng, found }) => [lng, found.join()]),
    [
      [0, "true,true,false"],
      [100, "true,false,true"],
      [9, "false,true,false"],
      [300, "false,true,true"],
    ],
  );
  assert.deepEqual(all.map(kindOfCompared), ["here", "here", "elsewhere", "elsewhere"]);
  assert.equal(kindOfCompared({ ...all[0], found: [true, true] }), "shared");
  assert.deepEqual(matchIntersections([[], []], true), []);
  const [own, other] = [places(0), places(3)];
  other[0].properties = { outcome: "wrong" };
  assert.deepEqual(matchIntersections([own, other], true)[0].outcomes, [null, "wrong"]);
});

test("a map that is sent does not take the place of one that the drive has", () => {
  assert.equal(freeName("town.osm.gz", []), "town.osm.gz");
  assert.equal(freeName("town.osm.gz", ["Town.osm.gz", "town-2.osm.gz"]), "town-3.osm.gz");
});

test("settings by path become those of sections again", () => {
  const config = { bev: { resolution_m: 0.25, size_m: 100 }, compound: null };
  assert.deepEqual(nest(flatten(config)), config);
});
