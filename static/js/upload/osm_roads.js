/** The roads of an OSM file near a track, and how much of the track it covers. Only for a look: the service scores. */

/** @typedef {{simulator: string, drivable: string[]}} Words Of OSM files, as the service reads them. */
/** @typedef {{west: number, south: number, east: number, north: number}} Box Degrees. */
/** @typedef {{line: number[][], properties: {highway: string, is_drivable: boolean}}} Road As results have them. */

/**
 * @typedef {object} MapLook
 * @property {Road[]} roads
 * @property {boolean} isMadeUp By the simulator: it is not of OpenStreetMap.
 * @property {number} covered Share of the track inside the bounds of the map, 0..1.
 * @property {number | null} road_m Median distance of the track from the nearest road, metres; null: there is none.
 */

const NOWHERE = { west: Infinity, south: Infinity, east: -Infinity, north: -Infinity };
const MARGIN_DEG = 0.01; // about a kilometre
const MAX_CHARACTERS = 1e9;
const MAX_NODES = 3e6;
const MAX_SAMPLES = 200;
const METRES_PER_DEGREE = 111_320;
const ELEMENT = /<(\/?)(osm|bounds|node|way|nd|tag)\b([^>]*)>/g; // a ">" in a value is written as &gt;

/** @param {string} name @returns {boolean} Whether the browser can read such a file: XML, plain or packed by gzip. */
export const isReadableMap = (name) => /\.osm(\.gz)?$/i.test(name);

/**
 * @param {File} file
 * @param {number[][]} track Longitude, latitude.
 * @param {Words} words
 * @returns {Promise<MapLook | null>} null: it is too large to look into, or no OSM XML.
 */
export async function lookIntoMap(file, track, words) {
  const packed = /\.gz$/i.test(file.name);
  const stream = packed ? file.stream().pipeThrough(new DecompressionStream("gzip")) : file.stream();
  const near = boxAround(track);
  const extent = { ...NOWHERE };
  /** @type {Box | null} */
  let bounds = null;
  let isMadeUp = false;
  /** Those near the track. @type {Map<string, number[]>} */
  const nodes = new Map();
  /** @type {Road[]} */
  const roads = [];
  /** The way that is being read. @type {{refs: string[], highway: string} | null} */
  let way = null;
  const take = (/** @type {string} */ name, /** @type {string} */ text) => {
    if (name === "tag" && !way) return; // of a node
    const of = (/** @type {string} */ each) => attribute(text, each);
    const numbers = (/** @type {string[]} */ ...names) => names.map((each) => Number.parseFloat(of(each)));
    if (name === "node") {
      const [lon, lat] = numbers("lon", "lat");
      if (!Number.isFinite(lon) || !Number.isFinite(lat)) return;
      grow(extent, lon, lat);
      if (isIn(near, lon, lat)) nodes.set(of("id"), [lon, lat]);
    } else if (name === "way") way = { refs: [], highway: "" };
    else if (name === "nd") way?.refs.push(of("ref"));
    else if (name === "tag" && way && of("k") === "highway") way.highway = of("v");
    else if (name === "osm") isMadeUp = of("generator") === words.simulator;
    else if (name === "bounds") {
      const [west, south, east, north] = numbers("minlon", "minlat", "maxlon", "maxlat");
      if ([west, south, east, north].every(Number.isFinite)) bounds = { west, south, east, north };
    }
  };
  const endWay = () => {
    if (way?.highway) {
      const properties = { highway: way.highway, is_drivable: words.drivable.includes(way.highway) };
      for (const line of linesOf(way.refs, nodes)) roads.push({ line, properties });
    }
    way = null;
  };
  let rest = "";
  let read = 0;
  const reader = stream.pipeThrough(/** @type {any} */ (new TextDecoderStream())).getReader();
  for (;;) {
    const { done, value } = await reader.read();
    if (done) break;
    read += value.length;
    if (read > MAX_CHARACTERS || nodes.size > MAX_NODES) {
      await reader.cancel();
      return null;
    }
    const text = rest + value;
    const end = text.lastIndexOf(">") + 1;
    rest = text.slice(end);
    for (const [, closing, name, attributes] of text.slice(0, end).matchAll(ELEMENT)) {
      if (!closing) take(name, attributes);
      else if (name === "way") endWay();
    }
  }
  const whole = /** @type {Box} */ (bounds ?? extent);
  if (!(whole.west <= whole.east)) return null;
  const inside = track.filter(([lon, lat]) => isIn(whole, lon, lat)).length;
  return { roads, isMadeUp, covered: inside / track.length, road_m: medianDistance(track, roads) };
}

/** What is known of a way: one that leaves the box becomes several. @param {string[]} refs @param {Map<string, number[]>} nodes */
function linesOf(refs, nodes) {
  /** @type {number[][][]} */
  const lines = [[]];
  for (const ref of refs) {
    const place = nodes.get(ref);
    if (place) lines[lines.length - 1].push(place);
    else lines.push([]);
  }
  return lines.filter((line) => line.length > 1);
}

/** @param {string} text Attributes as OSM's own tools write them. @param {string} name @returns {string} "" for none. */
function attribute(text, name) {
  const at = text.indexOf(` ${name}=`) + name.length + 2;
  if (at <= name.length + 1) return "";
  return text.slice(at + 1, text.indexOf(text[at], at + 1));
}

/** Let a box hold a place. @param {Box} box @param {number} lon @param {number} lat */
function grow(box, lon, lat) {
  box.west = Math.min(box.west, lon);
  box.east = Math.max(box.east, lon);
  box.south = Math.min(box.south, lat);
  box.north = Math.max(box.north, lat);
}

/** @param {number[][]} places @returns {Box} Around them, with a margin. */
function boxAround(places) {
  const box = { ...NOWHERE };
  for (const [lon, lat] of places) grow(box, lon, lat);
  const { west, south, east, north } = box;
  const aside = MARGIN_DEG / Math.cos((south * Math.PI) / 180);
  return { west: west - aside, south: south - MARGIN_DEG, east: east + aside, north: north + MARGIN_DEG };
}

/** @param {Box} box @param {number} lon @param {number} lat */
const isIn = ({ west, south, east, north }, lon, lat) => lon >= west && lon <= east && lat >= south && lat <= north;

/** @param {number[][]} track @param {Road[]} roads */
function medianDistance(track, roads) {
  const lines = roads.filter(({ properties }) => properties.is_drivable).map(({ line }) => line);
  if (!lines.length) return null;
  const flat = lines.map((line) => line.map((place) => toMetres(place, track[0])));
  const step = Math.ceil(track.length / MAX_SAMPLES);
  const distances = [];
  for (let i = 0; i < track.length; i += step) {
    const [x, y] = toMetres(track[i], track[0]);
    let nearest = Infinity;
    for (const line of flat) {
      for (let j = 1; j < line.length; j += 1) nearest = Math.min(nearest, distance(x, y, line[j - 1], line[j]));
    }
    distances.push(Math.sqrt(nearest));
  }
  return distances.sort((a, b) => a - b)[Math.floor(distances.length / 2)];
}

/** @param {number[]} place Longitude, latitude. @param {number[]} origin @returns {number[]} East and north, metres. */
function toMetres([lon, lat], origin) {
  const parallel = METRES_PER_DEGREE * Math.cos((origin[1] * Math.PI) / 180);
  return [(lon - origin[0]) * parallel, (lat - origin[1]) * METRES_PER_DEGREE];
}

/** @param {number} x @param {number} y @param {number[]} a @param {number[]} b @returns {number} Squared, to the segment. */
function distance(x, y, [ax, ay], [bx, by]) {
  const [dx, dy] = [bx - ax, by - ay];
  const length = dx * dx + dy * dy;
  const t = length ? Math.max(0, Math.min(1, ((x - ax) * dx + (y - ay) * dy) / length)) : 0;
  return (ax + t * dx - x) ** 2 + (ay + t * dy - y) ** 2;
}
