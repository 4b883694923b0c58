import assert from "node:assert/strict";
import { test } from "node:test";

import { withService } from "../../../static/js/data/results.js";
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

test("service roads count as the report says of them, and detections keep their verdicts", () => {
  const wrong = { id: 6, outcome: "wrong", names: "A / B", confidence: 0.9 };
  const told = { id: 6, outcome: "right", osm_id: 7, error_m: 2, reason: null, names: "A / B" };
  const other = {
    policy: "drive+service",
    map_line: "1 of 1",
    intersections: [told],
    nodes: [{ osm_id: 7, lon: 8, lat: 49 }],
  };
  const result = {
    report: { policy: "drive", map_line: "0 of 1", ace_m: 1, with_service: other },
    intersections: [{ lng: 8, lat: 49, properties: wrong }],
    nodes: [],
    detections: [{ outcome: "FP" }],
  };
  const switched = withService(/** @type {any} */ (result));
  assert.deepEqual(switched.intersections[0].properties, { ...wrong, ...told });
  assert.deepEqual(switched.nodes, [{ lng: 8, lat: 49, properties: other.nodes[0] }]);
  assert.equal(switched.report.policy, "drive+service");
  assert.equal(switched.report.ace_m, 1);
  assert.equal(switched.detections, result.detections);
  assert.equal(result.report.policy, "drive");
});
