import assert from "node:assert/strict";
import { test } from "node:test";

import { distanceM } from "../../../static/js/data/frame.js";
import { lineOf, medianError } from "../../../static/js/data/results.js";
import { formatDate } from "../../../static/js/dom.js";
import { ellipseOf } from "../../../static/js/map/ellipse.js";
import { matches } from "../../../static/js/map/filter.js";
import { kindOfNode } from "../../../static/js/map/layers.js";
import { coordinates, linksAt, noteText } from "../../../static/js/map/links.js";
import { compare } from "../../../static/js/report/sorted_table.js";

const wrong = {
  lng: 8.4,
  lat: 49,
  properties: {
    id: 3,
    uid: "49.00010,8.40094",
    outcome: "wrong",
    osm_id: null,
    confidence: 0.7,
    observations: 6,
    position_std_m: 0.5634,
    branch_bearings_deg: [1, 90.4],
    reason: "nothing in OpenStreetMap within 20 m explains it: worth a look",
  },
};
const right = {
  lng: 8.4,
  lat: 49,
  properties: { ...wrong.properties, id: 24, uid: "n77", outcome: "right", osm_id: 77, error_m: 0.98, reason: null },
};

test("a filter goes by verdict, by figures and by words", () => {
  const any = { verdicts: null, words: "", ranges: {} };
  const passing = (wanted) => [wrong, right].filter((each) => matches({ ...any, ...wanted }, each));
  assert.deepEqual(passing({}), [wrong, right]);
  assert.deepEqual(passing({ verdicts: ["wrong", "unscored"] }), [wrong]);
  assert.deepEqual(passing({ ranges: { confidence: [0.7, null], observations: [null, 6] } }), [wrong, right]);
  assert.deepEqual(passing({ ranges: { position_std_m: [null, 0.5] } }), []);
  for (const words of ["3", " Worth a LOOK ", "49.0001"]) assert.deepEqual(passing({ words }), [wrong], words);
  for (const words of ["24", "77", "n77"]) assert.deepEqual(passing({ words }), [right], words);
  assert.deepEqual(passing({ words: "2" }), [], "a number is a whole id");
});

test("the map decides what became of a node; the detections, where the result says no more", () => {
  const kind = (properties) => kindOfNode({ properties });
  assert.equal(kind({ found: false, in_zone: true, outcome: "found" }), "found");
  assert.equal(kind({ found: true, in_zone: true }), "found");
  assert.equal(kind({ found: false, in_zone: true }), "missed");
});

test("a node that was found is measured by what is right of it", () => {
  const result = {
    matches: [
      [1, "TP", 0.5],
      [1, "TP", 0.7],
      [1, "FP", 21],
      [2, "FP", 9],
    ].map(([osm_id, outcome, error_m]) => ({ osm_id, outcome, error_m })),
  };
  assert.equal(medianError(result, { osm_id: 1, median_error_m: 0.7 }), 0.6);
  assert.equal(medianError(result, { osm_id: 2, median_error_m: 9 }), 9);
  assert.equal(medianError(result, { osm_id: 3, median_error_m: null }), null);
});

test("distances are those of the ellipsoid, or of the plane of W", () => {
  const [a, b] = [
    { lat: 49, lng: 8.4 },
    { lat: 49.01, lng: 8.41 },
  ];
  assert.ok(Math.abs(distanceM(a, b, false) - 1331.19) < 0.01); // Karney's algorithm
  assert.equal(distanceM({ lat: 1, lng: 2 }, { lat: 5, lng: 5 }, true), 5);
});

test("the ways out lead to the place, in the words of each site", () => {
  const [osm, id, josm, mapillary] = linksAt(49.0200123, 8.4200456, 77).map(({ href }) => new URL(href));
  assert.equal(osm.searchParams.get("mlat"), "49.0200123");
  assert.equal(osm.hash, "#map=19/49.0200123/8.4200456");
  assert.equal(id.searchParams.get("node"), "77");
  assert.equal(josm.origin + josm.pathname, "http://127.0.0.1:8111/load_and_zoom");
  const box = Object.fromEntries([...josm.searchParams].slice(0, 4).map(([name, value]) => [name, Number(value)]));
  assert.ok(box.left < 8.42 && box.right > 8.42005 && box.bottom < 49.02 && box.top > 49.02002);
  assert.ok(Math.abs(distanceM({ lat: 49.02, lng: box.left }, { lat: 49.02, lng: box.right }, false) - 150) < 1);
  assert.equal(josm.searchParams.get("select"), "node77");
  assert.equal(mapillary.searchParams.get("lng"), "8.4200456");
  assert.equal(coordinates({ lat: 49, lng: 8.4 }, false), "49.0000000, 8.4000000");
  assert.equal(coordinates({ lat: 1.239, lng: -8 }, true), "-8.00, 1.24");
});

test("a note says what was seen, how sure it is, and what the map has", () => {
  const date = "2015-02-17T11:18:02Z";
  assert.equal(
    noteText({ kind: "intersection", item: wrong }, date),
    "A LiDAR drive saw a junction at 49.0000000, 8.4000000, ±0.6 m, in 6 scans; its roads leave at 1°, 90°. " +
      "OpenStreetMap of 17 Feb 2015 has no such junction there: " +
      "nothing in OpenStreetMap within 20 m explains it: worth a look.",
  );
  assert.match(noteText({ kind: "intersection", item: right }, date), /has it as node 77, 1\.0 m away\.$/);
  const node = {
    lng: 8,
    lat: 49,
    properties: { osm_id: 5, degree: 3, outcome: "missed", reason: "branches too short" },
  };
  assert.match(noteText({ kind: "node", item: node }), /^Node 5 .* 3 roads, but a LiDAR drive did not find it: branch/);
});

test("rows are sorted by numbers and by words, and what has no value comes last both ways", () => {
  const sorted = (values, down) => [...values].sort((a, b) => compare(a, b, down));
  assert.deepEqual(sorted([3, null, 20, 1], false), [1, 3, 20, null]);
  assert.deepEqual(sorted([3, null, 20, 1], true), [20, 3, 1, null]);
  assert.deepEqual(sorted(["n10", undefined, "n9"], false), ["n9", "n10", undefined]);
});

test("dates are told without their time", () => {
  assert.equal(formatDate("2015-02-17T11:18:02Z"), "17 Feb 2015");
  assert.equal(formatDate("unknown"), "unknown");
});

test("a line across the antimeridian is one line again", () => {
  const parts = [
    [
      [179.9, 0],
      [180, 0.5],
    ],
    [
      [-180, 0.5],
      [-179.9, 1],
    ],
  ];
  assert.deepEqual(lineOf({ type: "MultiLineString", coordinates: parts }), parts.flat());
  assert.deepEqual(lineOf({ type: "LineString", coordinates: parts[0] }), parts[0]);
  assert.deepEqual(lineOf(null), []);
});

test("an ellipse has the axes of its covariance, and is a circle in results before covariances", () => {
  const { major, minor, bearing } = ellipseOf({ position_cov_m2: [2.5, 1.5, 2.5], position_std_m: 1.58 });
  assert.deepEqual(
    [major, minor, (bearing * 180) / Math.PI].map((each) => Math.round(1e6 * each) / 1e6),
    [2, 1, 45],
  );
  assert.equal(ellipseOf({ position_cov_m2: [4, 0, 1] }).bearing, Math.PI / 2);
  assert.deepEqual(ellipseOf({ position_std_m: 0.5 }), { major: 0.5, minor: 0.5, bearing: 0 });
});
