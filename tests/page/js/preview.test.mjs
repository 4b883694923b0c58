import assert from "node:assert/strict";
import { test } from "node:test";
import { gzipSync } from "node:zlib";

import { lookIntoMap } from "../../../static/js/upload/osm_roads.js";
import { mapVerdict } from "../../../static/js/upload/preview.js";

const LAT = 49;
const LON = 8.4;
const METRE = 1 / 111320;
const EAST = METRE / Math.cos((LAT * Math.PI) / 180);

const file = (text, name) => new File([text], name);
const WORDS = { simulator: "interloc simulate", drivable: ["residential"] };
const node = (id, x, y) => `<node id="${id}" lat="${LAT + y * METRE}" lon='${LON + x * EAST}' version="1"/>`;
const way = (refs, kind) =>
  `<way id="9"><nd ref="${refs.join('"/><nd ref="')}"/><tag k="name" v="a &gt; b"/><tag k="highway" v="${kind}"/></way>`;
const OSM = `<?xml version="1.0"?><osm><bounds minlat="${LAT - 50 * METRE}" minlon="${LON - 50 * EAST}"
  maxlat="${LAT + 50 * METRE}" maxlon="${LON + 10.1 * EAST}"/>
${[node(1, -40, 2), node(2, 0, 2), node(3, 40, 2), node(4, 5000, 2)].join("\n")}
${way([1, 2, 3, 4], "residential")}${way([1, 3], "footway")}
<way id="10"><nd ref="1"/><nd ref="3"/><tag k="building" v="yes"/></way></osm>`;

test("roads near a track are read from OSM XML, plain or packed, and how much of it the map covers", async () => {
  const track = [0, 10, 20, 30].map((x) => [LON + x * EAST, LAT]);
  for (const map of [file(OSM, "map.osm"), new File([gzipSync(OSM)], "map.osm.gz")]) {
    const look = await lookIntoMap(map, track, WORDS);
    assert.deepEqual(
      look.roads.map(({ line, properties }) => [line.length, properties.highway, properties.is_drivable]),
      [
        [3, "residential", true], // its last node lies five kilometres away
        [2, "footway", false],
      ],
    );
    assert.equal(look.covered, 0.5);
    assert.ok(Math.abs(look.road_m - 2) < 0.05);
  }
  assert.equal((await lookIntoMap(file(OSM, "map.osm"), track, WORDS)).isMadeUp, false);
  const simulated = OSM.replace("<osm>", '<osm version="0.6" generator="interloc simulate">');
  assert.equal((await lookIntoMap(file(simulated, "map.osm"), track, WORDS)).isMadeUp, true); // and no credit is due
  assert.equal(await lookIntoMap(file("no map", "map.osm"), track, WORDS), null);
});

test("a verdict says what the map is worth for the drive", () => {
  const map = (name) => file("", name);
  const look = (covered, road_m) => ({ covered, road_m, roads: [{}, {}] });
  const found = (covered, road_m) => ({ track: { local: false }, look: look(covered, road_m), isDone: true });
  assert.match(mapVerdict(map("a.osm"), found(1, 0.8))[0], /covers 100 % .*: 2 roads nearby, 0\.8.m from the track/);
  assert.equal(mapVerdict(map("a.osm"), found(1, 0.8))[1], false);
  assert.match(mapVerdict(map("a.osm"), found(0, null))[0], /lies elsewhere/);
  assert.match(mapVerdict(map("a.osm"), found(0.5, 3))[0], /50\.0.% .*beyond the map count for nothing/);
  assert.match(mapVerdict(map("a.osm"), found(1, 40))[0], /is the georeference that of this drive\?/);
  assert.match(mapVerdict(map("a.osm.pbf"), found(1, 1))[0], /The service reads a\.osm\.pbf/);
});
