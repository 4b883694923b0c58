import assert from "node:assert/strict";
import { test } from "node:test";

import { setConfig } from "../../../static/js/api.js";
import { formatBytes, formatDuration, formatMetres, plural } from "../../../static/js/dom.js";
import { at, curve, histogram, sequenceOf } from "../../../static/js/report/scores.js";

test("a drive is taken for a KITTI sequence by its name alone", () => {
  setConfig({ raw_sequences: { "2011_09_30_drive_0018": "05", "2011_10_03_drive_0027": "00" } });
  const named = {
    "2011_09_30_drive_0018": "05",
    "2011_09_30_drive_0018_sync": "05",
    "2011_10_03_drive_0027 again": "00",
    "07": "07",
    "sequences/08": "08",
    "KITTI 10": "10",
    seq02: "02",
  };
  for (const [name, sequence] of Object.entries(named)) assert.equal(sequenceOf(name), sequence, name);
  for (const name of ["street", "100", "2026-11-07", "Demo: a small made-up town", "drive 07b", "011"])
    assert.equal(sequenceOf(name), null, name);
});

test("the last bin takes all errors beyond", () => {
  assert.deepEqual(histogram([0, 0.49, 0.5, 1.99, 2, 117], 0.5, 4), [2, 1, 0, 1, 2]);
  assert.deepEqual(histogram([], 0.5, 2), [0, 0, 0]);
});

test("scores are read by their distance, in its order", () => {
  const report = {
    precision: { "10.0": 1, 0.5: 0.2, 6.9: null },
    recall: { "10.0": 1, 0.5: 0.5, 6.9: 0.7 },
    f1: {},
    tp: { 0.5: 3 },
    fp: {},
    fn: {},
  };
  assert.deepEqual(
    curve(report).map(({ d }) => d),
    [0.5, 6.9, 10],
  );
  assert.equal(at(report, 0.5).tp, 3);
  assert.equal(at(report, 6.9).precision, null);
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
});
