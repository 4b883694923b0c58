import assert from "node:assert/strict";
import { test } from "node:test";

import { overlap, spots, takenBySign } from "../../../static/js/map/street_names.js";

const view = { x: (x) => x, y: (y) => y };
const path = (...corners) => Float64Array.from(corners.flat());

test("a name stands in the middle of a street that is hardly longer", () => {
  assert.deepEqual(spots(path([0, 10], [120, 10]), view, 100), [{ x: 60, y: 10, angle: 0 }]);
  assert.deepEqual(spots(path([0, 10], [90, 10]), view, 100), []);
  assert.deepEqual(spots(path([5, 5]), view, 100), []);
});

test("a long street has room for several, and none of them is upside down", () => {
  const found = spots(path([400, 0], [200, 0], [0, 0]), view, 100);
  assert.deepEqual(
    found.map(({ x }) => x),
    [350, 300, 250, 200, 150, 100, 50],
  );
  assert.ok(found.every(({ angle }) => Math.abs(angle) === 0));
  const [upwards] = spots(path([0, 120], [0, 0]), view, 100);
  assert.ok(Math.abs(upwards.angle + Math.PI / 2) < 1e-9);
});

test("no name goes around a corner", () => {
  const found = spots(path([0, 0], [150, 0], [150, 150]), view, 100);
  assert.ok(found.length >= 2);
  assert.ok(found.every(({ x, y }) => y === 0 || x === 150));
});

test("names lie neither on each other nor on signs, and none is written twice side by side", () => {
  const text = (name, x, y) => ({ x, y, name, cos: 1, sin: 0, reach: 30 });
  assert.ok(overlap(text("A", 0, 0), text("B", 50, 5)));
  assert.ok(!overlap(text("A", 0, 0), text("B", 0, 20)), "one below the other");
  assert.ok(overlap(text("A", 0, 0), text("A", 200, 0)));
  assert.ok(overlap(text("A", 0, 0), takenBySign(25, 8)));
  assert.ok(!overlap(text("A", 0, 0), takenBySign(60, 0)));
});
