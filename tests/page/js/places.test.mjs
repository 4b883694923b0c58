import assert from "node:assert/strict";
import { test } from "node:test";

import { ellipseOf } from "../../../static/js/data/frame.js";
import { lineOf } from "../../../static/js/data/results.js";
import { formatBytes, formatDate, formatDuration, formatMetres, plural } from "../../../static/js/dom.js";
import { coordinates } from "../../../static/js/map/facts.js";
import { matches } from "../../../static/js/map/filter.js";
import { kindOfNode } from "../../../static/js/map/layers.js";
import { compare } from "../../../static/js/report/sorted_table.js";

test("intersections are found by an id, a place or words of the reason", () => {
  const reason = "nothing in OpenStreetMap within 20 m explains it: worth a look";
  const wrong = { id: 3, uid: "49.00010,8.40094", osm_id: null, reason, names: null };
  const right = { id: 24, uid: "n77", osm_id: 77, reason: null, names: "Am Markt / Ring" };
  const passing = (words) => [wrong, right].filter((each) => matches(words, each));
  assert.deepEqual(passing(" "), [wrong, right]);
  for (const words of ["3", " Worth a LOOK ", "49.0001"]) assert.deepEqual(passing(words), [wrong], words);
  for (const words of ["24", "77", "n77", "markt"]) assert.deepEqual(passing(words), [right], words);
  assert.deepEqual(passing("2"), [], "a number is a whole id");
});

test("the map decides what became of a node; the detections, where the result says no more", () => {
  const kind = (properties) => kindOfNode({ properties });
  assert.equal(kind({ found: false, in_zone: true, outcome: "found" }), "found");
  assert.equal(kind({ found: true, in_zone: true }), "found");
  assert.equal(kind({ found: false, in_zone: true }), "missed");
});

test("figures are told as people write them", () => {
  const plain = (text) => text.replaceAll("\u00a0", " ");
  assert.deepEqual([0, 999, 1000, 999_950, 11_400_000_000].map(formatBytes).map(plain), [
    "0 B",
    "999 B",
    "1.0 kB",
    "1.0 MB",
    "11.4 GB",
  ]);
  assert.deepEqual([0.04, 9.94, 59.6, 75, 3599.7, 7300].map(formatDuration).map(plain), [
    "0.0 s",
    "9.9 s",
    "1 min 00 s",
    "1 min 15 s",
    "1 h 00 min",
    "2 h 02 min",
  ]);
  assert.equal(formatDuration(null), "–");
  assert.deepEqual(
    [1.157, 2345, null].map((each) => plain(formatMetres(each))),
    ["1.16 m", "2.3 km", "–"],
  );
  assert.deepEqual([plural(1, "branch", "branches"), plural(1234, "scan")], ["1 branch", "1,234 scans"]);
  assert.equal(coordinates({ lat: 49, lng: 8.4 }, false), "49.0000000, 8.4000000");
  assert.equal(coordinates({ lat: 1.239, lng: -8 }, true), "-8.00, 1.24");
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
