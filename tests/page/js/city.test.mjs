import assert from "node:assert/strict";
import { test } from "node:test";

import { versionOf } from "../../../static/js/data/city.js";
import {
  kindName,
  partsOf,
  placeSign,
  precisionText,
  signOfChange,
  streetsOf,
} from "../../../static/js/map/city_places.js";

test("changes are told by their signs", () => {
  const kinds = ["new_junction", "gone_branch"].map((kind) => ({ properties: { kind } }));
  assert.deepEqual(kinds.map(signOfChange), ["here", "elsewhere"]);
});

test("a place is a question, one that was looked at, one without objection, or not known to be any", () => {
  assert.equal(placeSign(2, { verdict: null }, true), "wrong");
  assert.equal(placeSign(2, { verdict: "right" }, true), "outside");
  assert.equal(placeSign(2, null, true), "right");
  assert.equal(placeSign(1, null, true), "unscored");
  assert.equal(placeSign(9, null, false), "unscored");
});

test("the parts of a box are the box", () => {
  const parts = partsOf([8, 49, 10, 51], 2);
  assert.deepEqual(parts, [
    [8, 49, 9, 50],
    [8, 50, 9, 51],
    [9, 49, 10, 50],
    [9, 50, 10, 51],
  ]);
});

test("findings in words", () => {
  const none = { right: 0, wrong: 0, cannot_tell: 3, share: null, low: null, high: null };
  assert.equal(precisionText(none), "How many are right is not known yet.");
  const some = { right: 8, wrong: 1, cannot_tell: 0, share: 8 / 9, low: 0.566, high: 0.98 };
  assert.equal(precisionText(some), "8 of 9 right: 89 % (95 %: 57 to 98 %).");
  const ways =
    "way/1 highway=residential name=Am Markt surface=asphalt; way/2 highway=service; way/3 highway=tertiary name=Ring";
  assert.equal(streetsOf(ways), "Am Markt / Ring");
  assert.equal(streetsOf(null), "");
  assert.equal(kindName("missing_junction"), "Missing junction");
});

test("a map is another one when it was merged or compared again", () => {
  const city = { id: "a", revision: 1, is_waiting: false, findings: 2, bbox: [0, 0, 1, 1] };
  assert.equal(versionOf(city), versionOf({ ...city, name: "renamed" }));
  assert.notEqual(versionOf(city), versionOf({ ...city, findings: 1 }));
});
