import assert from "node:assert/strict";
import { test } from "node:test";
import { gzipSync } from "node:zlib";

import { setConfig } from "../../../static/js/api.js";
import { lookIntoMap } from "../../../static/js/upload/osm_roads.js";
import { fitVerdict, mapVerdict, trackFilesOf } from "../../../static/js/upload/preview.js";
import { readFixes, readPoses, readTrack } from "../../../static/js/upload/track.js";

const LAT = 49;
const LON = 8.4;
const METRE = 1 / 111320;
const EAST = METRE / Math.cos((LAT * Math.PI) / 180);

const WORLD = { lat_deg: 48.9843445, lon_deg: 8.4295857, min_alt_m: 50, max_alt_m: 400 };

const file = (text, name) => new File([text], name);
const near = (found, expected, within = 0.01) =>
  found.forEach((value, i) => assert.ok(Math.abs(value - expected[i]) < within, `${found} is not ${expected}`));

/** Ten metres a scan to the east, then to the north: LiDAR poses, fixes. */
const CORNER = [0, 1, 2, 3, 4, 5].map((i) => (i < 3 ? [10 * i, 0] : [20, 10 * (i - 2)]));
const LIDAR = CORNER.map(([x, y]) => `1 0 0 ${x} 0 1 0 ${y} 0 0 1 0`).join("\n");
const GEO = `frame,lat_deg,lon_deg,alt_m,roll_rad,pitch_rad,yaw_rad\n${CORNER.map(
  ([x, y], i) => `${i},${LAT + y * METRE},${LON + x * EAST},0,0,0,0`,
).join("\n")}\n`;

/** The same drive as a camera sees it, in a world of its own: z forward, x right. */
function cameraPoses() {
  return CORNER.map(([x, y], i) => {
    const rotation = i < 2 ? [1, 0, 0, 0, 1, 0, 0, 0, 1] : [0, 0, -1, 0, 1, 0, 1, 0, 0]; // it has turned left
    const [a, b, c, d, e, f, g, h, j] = rotation;
    return [a, b, c, -y, d, e, f, 0, g, h, j, x].join(" ");
  }).join("\n");
}

test("poses are positions on the ground, of whichever sensor", () => {
  near([...readPoses(LIDAR, [], "auto").values()].flat(), CORNER.flat());
  near([...readPoses(cameraPoses(), [], "auto").values()].flat(), CORNER.flat());
  const asLidar = readPoses(cameraPoses(), [], "lidar");
  near(asLidar.get(2), [0, 0]); // the wrong frame: what drives forward goes up
  const indexed = LIDAR.split("\n").map((line, i) => `${100 + 2 * i} ${line}`);
  assert.deepEqual([...readPoses(indexed.join("\n"), [], "auto").keys()].slice(0, 2), [100, 102]);
  const tum = CORNER.map(([x, y], i) => `${i}.5 ${x} ${y} 0 0 0 0 1`).join("\n");
  near(readPoses(tum, [7, 8, 9, 10, 11, 12], "auto").get(12), [20, 30]);
});

test("fixes are read from geo.csv and rows of OXTS, by the numbers of the scans", () => {
  near(readFixes(GEO, []).get(5), [LON + 20 * EAST, LAT + 30 * METRE], 1e-9);
  const rows = CORNER.map((_, i) => `${LAT + i} ${LON} 110 ${"0 ".repeat(27)}`).join("\n");
  assert.deepEqual(readFixes(rows, [1, 4]).get(4), [LON, LAT + 4]);
  assert.equal(readFixes("0 0 0\n0 0 0\n", []).size, 0); // no fix yet
});

test("a track says how the poses fit the georeference", async () => {
  const frames = [0, 1, 2, 3, 4, 5];
  const all = { frames, poses: file(LIDAR, "poses.txt"), pose_frame: "auto", fixes: file(GEO, "geo.csv"), oxts: [] };
  const track = await readTrack(all);
  assert.equal(track.local, false);
  assert.ok(Math.abs(track.length_m - 50) < 0.1);
  assert.ok(track.fit_m < 0.1);
  assert.deepEqual(fitVerdict(track)[1], false);
  const wrong = await readTrack({ ...all, poses: file(LIDAR.replaceAll("20", "90"), "poses.txt") });
  assert.ok(wrong.fit_m > 10);
  assert.match(fitVerdict(wrong)[0], /do both belong to this drive\?/);
  const local = await readTrack({ ...all, fixes: null });
  assert.equal(local.local, true);
  near(local.scans.at(-1), [20, 30]);
  const oxts = CORNER.map(([x, y], i) => [i, file(`${LAT + y * METRE} ${LON + x * EAST} 0\n`, `${i}.txt`)]);
  near((await readTrack({ ...all, poses: null, fixes: null, oxts })).scans.at(-1), track.scans.at(-1), 1e-9);
  assert.equal(await readTrack({ ...all, poses: null, fixes: null }), null);
});

test("poses in the world of KITTI-360 are places", async () => {
  const line = (frame, x, y, z) => `${frame} 1 0 0 ${x} 0 -1 0 ${y} 0 0 -1 ${z}\n`;
  const files = { frames: [4, 5], pose_frame: "auto", world: WORLD, fixes: null, oxts: [] };
  const poses = file(line(4, 0, 0, 116) + line(5, 0, 100, 116), "poses.txt");
  const track = await readTrack({ ...files, poses });
  assert.equal(track.local, false);
  near(track.scans[0], [8.4295857, 48.9843445], 1e-9);
  near(track.scans[1], [8.4295857, 48.9843445 + 100 / 111_320], 1e-5); // north
  const moved = await readTrack({ ...files, poses: file(line(4, 0, 0, 0) + line(5, 1, 0, 0), "poses.txt") });
  assert.equal(moved.local, true);
});

test("the files of a track are found among those of a drive", () => {
  const drive = (...names) => ({ scans: null, small: new Map(names.map((name) => [name, file("", name)])) });
  const of = (...names) => trackFilesOf(drive(...names), null, "auto", null);
  assert.equal(of("poses.txt", "geo.csv", "oxts/data/0000000000.txt").fixes.name, "geo.csv");
  assert.deepEqual(
    of("oxts/data/0000000003.txt", "oxts/data/0000000004.txt", "oxts/timestamps.txt").oxts.map(([frame]) => frame),
    [3, 4],
  );
  setConfig({ kitti360_world: WORLD });
  assert.equal(of("data_poses/drive/poses.txt").world, WORLD);
  assert.equal(of("poses.txt").world, null);
  const rows = of("oxts/07.txt.gz");
  assert.deepEqual([rows.oxts.length, rows.fixes.name], [0, "oxts/07.txt.gz"]);
});

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
