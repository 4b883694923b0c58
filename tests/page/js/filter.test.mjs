import assert from "node:assert/strict";
import { test } from "node:test";

import { formatFilter, matches, parseFilter } from "../../../static/js/map/filter.js";

const ALL = { verdicts: null, words: "", ranges: {} };

test("a filter comes back from the address as it was, words last and whole", () => {
  const filter = {
    verdicts: ["wrong", "unscored"],
    words: "100 % & a; find:b=c ",
    ranges: { confidence: [0.55, null], position_std_m: [null, 1.5], observations: [3, 40] },
  };
  const text = formatFilter(filter);
  assert.equal(
    text,
    "outcome:wrong,unscored;confidence:0.55..;observations:3..40;uncertainty_m:..1.5;find:100 % & a; find:b=c ",
  );
  assert.deepEqual(parseFilter(text), { ...filter, verdicts: ["wrong", "unscored"] });
  assert.deepEqual(parseFilter(formatFilter({ ...ALL, verdicts: [] })).verdicts, []);
  assert.deepEqual(parseFilter("find:x"), { ...ALL, words: "x" });
  assert.equal(formatFilter({ ...ALL, words: "  ", ranges: { confidence: [null, null] } }), null);
});

test("what an address says and nobody understands filters nothing", () => {
  for (const text of ["", "outcome:late", "confidence:a..b", "confidence:0.5", "__proto__:1..2", "..;:;"]) {
    const filter = parseFilter(text);
    assert.deepEqual(filter, ALL);
    assert.ok(matches(filter, { properties: { outcome: "right" } }));
  }
});
