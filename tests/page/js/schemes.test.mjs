import assert from "node:assert/strict";
import { test } from "node:test";

import { namedScheme } from "../../../static/js/upload/labels.js";
import { fingerprintOf } from "../../../static/js/upload/memory.js";
import { oxtsRows } from "../../../static/js/upload/oxts_rows.js";
import { judgeLabels, sampleOf } from "../../../static/js/upload/schemes.js";

/** One label file with so many points of each id. */
function labels(counts) {
  const ids = Object.entries(counts).flatMap(([id, count]) => Array(count).fill(Number(id)));
  const file = new File([new Uint32Array(ids.map((id) => id | (7 << 16)))], "000000.label");
  return { folder: "predictions", suffix: ".label", digits: 6, bytes: file.size, files: new Map([[0, file]]) };
}

test("labels are judged as the service judges them", async () => {
  const good = await judgeLabels(labels({ 40: 30, 60: 2, 48: 10, 70: 58 }), [0], "auto", false);
  assert.equal(good.scheme.name, "semantickitti");
  assert.equal(good.roadShare, 0.32);
  assert.deepEqual(good.problems, []);
  assert.deepEqual(
    [...good.counts].sort(([a], [b]) => a - b),
    [
      [40, 30],
      [48, 10],
      [60, 2],
      [70, 58],
    ],
  );

  const learning = await judgeLabels(labels({ 9: 3, 11: 2, 15: 5 }), [0], "auto", false);
  assert.equal(learning.scheme.name, "learning");

  const kitti360 = labels({ 7: 3, 8: 2, 21: 5 });
  assert.equal((await judgeLabels(kitti360, [0], "auto", true)).scheme.name, "kitti360");
});

test("a wrong scheme is named before anything is sent", async () => {
  const [wrong] = (await judgeLabels(labels({ 9: 3, 11: 2, 15: 5 }), [0], "semantickitti", false)).problems;
  assert.equal(wrong.severity, "error");
  assert.match(wrong.message, /looks like the learning scheme/);
  const [none] = (await judgeLabels(labels({ 50: 5, 70: 5 }), [0], "auto", false)).problems;
  assert.match(none.message, /no point of the scans looked at is road: the ids are 50, 70; road would be 40, 60/);
  const few = (await judgeLabels(labels({ 40: 1, 70: 999 }), [0], "auto", false)).problems;
  assert.deepEqual(
    few.map(({ severity }) => severity),
    ["warning"],
  );
  const unknown = (await judgeLabels(labels({ 40: 50, 333: 50 }), [0], "auto", false)).problems;
  assert.match(unknown[0].message, /50\.0 % of the points have ids that semantickitti does not know \(333\)/);
});

test("ids of road may be written in many ways, but must be ids", () => {
  assert.deepEqual(namedScheme("60, 40 40").road, [40, 60]);
  for (const bad of ["", "road", "40;60", "70000", "-1", "4.5"]) assert.throws(() => namedScheme(bad), /expected auto/);
});

test("samples are spread from the first to the last", () => {
  assert.deepEqual(sampleOf([1, 2, 3]), [1, 2, 3]);
  assert.deepEqual(sampleOf(Array.from({ length: 101 }, (_, i) => i)), [0, 25, 50, 75, 100]);
});

test("the fingerprint of a folder tells its files, whatever their order", () => {
  const file = (text, lastModified) => new File([text], "x", { lastModified });
  const files = [
    ["a", file("1", 5)],
    ["b", file("22", 6)],
  ];
  const mark = fingerprintOf(files);
  assert.equal(fingerprintOf([...files].reverse()), mark);
  assert.notEqual(
    fingerprintOf([
      ["a", file("1", 5)],
      ["b", file("22", 7)],
    ]),
    mark,
  );
  assert.notEqual(
    fingerprintOf([
      ["a", file("1", 5)],
      ["b", file("2", 6)],
    ]),
    mark,
  );
  assert.notEqual(
    fingerprintOf([
      ["a", file("1", 5)],
      ["c", file("22", 6)],
    ]),
    mark,
  );
});

test("the OXTS of a raw drive become one row a frame, from the first frame of the sequence", async () => {
  const raw = (name, count, from = 0) => ({
    name,
    handle: null,
    files: new Map(
      Array.from({ length: count }, (_, i) => {
        const path = `oxts/data/${String(i + from).padStart(10, "0")}.txt`;
        return [path, new File([`${i + from}  8.4\n`], "x")];
      }),
    ),
  });
  const rows = await (await oxtsRows(raw("2011_09_30_drive_0027_sync", 3))).text();
  assert.equal(rows, "0 8.4\n1 8.4\n2 8.4\n");
  const eighth = await (await oxtsRows(raw("2011_09_30_drive_0028_sync", 1103))).text();
  assert.equal(eighth, "1100 8.4\n1101 8.4\n1102 8.4\n");
  await assert.rejects(oxtsRows(raw("x", 3, 2)), /frames are missing/);
  await assert.rejects(oxtsRows(raw("x", 0)), /no OXTS file/);
});
