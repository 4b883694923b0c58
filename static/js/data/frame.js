/** From metres to the map: offsets around a keyframe on the ellipsoid, or plain metres without georeference. */

/** @import { Place } from "./results.js" */

const A = 6378137;
const E2 = 0.00669437999014;

/**
 * The distance of two places, metres: on the ellipsoid, exact to millimetres for as far as a drive goes.
 * @param {{lng: number, lat: number}} a
 * @param {{lng: number, lat: number}} b
 * @param {boolean} local They are metres of W.
 */
export function distanceM(a, b, local) {
  const [dx, dy] = [b.lng - a.lng, b.lat - a.lat];
  if (local) return Math.hypot(dx, dy);
  const { meridian, parallel } = radii((a.lat + b.lat) / 2);
  return Math.hypot((dx * Math.PI * parallel) / 180, (dy * Math.PI * meridian) / 180);
}

/** @param {number} lat Degrees. @returns {{meridian: number, parallel: number}} Radii of the ellipsoid there, metres. */
function radii(lat) {
  const phi = (lat * Math.PI) / 180;
  const w = Math.sqrt(1 - E2 * Math.sin(phi) ** 2);
  return { meridian: (A * (1 - E2)) / w ** 3, parallel: (A / w) * Math.cos(phi) };
}

export class Frame {
  /** @param {Place[]} keyframes @param {boolean} local Positions are metres of W. */
  constructor(keyframes, local) {
    this.local = local;
    this.rows = new Map(keyframes.map((each, row) => [each.properties.frame, row]));
    this.keyframes = keyframes;
  }

  /**
   * @param {{lng: number, lat: number}} origin
   * @param {number} east Metres; along x of W without georeference.
   * @param {number} north Metres; along y of W.
   * @returns {[number, number]} lat, lng of Leaflet.
   */
  offset(origin, east, north) {
    if (this.local) return [origin.lat + north, origin.lng + east];
    const { meridian, parallel } = radii(origin.lat);
    return [origin.lat + ((north / meridian) * 180) / Math.PI, origin.lng + ((east / parallel) * 180) / Math.PI];
  }

  /** How W lies at a keyframe: angle from east to its x axis, counter-clockwise, radians. @param {Place} keyframe */
  worldAngle({ properties }) {
    if (this.local) return 0;
    return Math.PI / 2 - (properties.heading_deg * Math.PI) / 180 - properties.world_yaw_rad;
  }

  /**
   * @param {Place} keyframe
   * @param {number} x Metres from the keyframe along x of W.
   * @param {number} y
   * @returns {[number, number]} lat, lng of Leaflet.
   */
  fromWorld(keyframe, x, y) {
    const angle = this.worldAngle(keyframe);
    return this.offset(keyframe, x * Math.cos(angle) - y * Math.sin(angle), x * Math.sin(angle) + y * Math.cos(angle));
  }

  /**
   * The corners of a square around a keyframe, aligned with the axes of W.
   * @param {Place} keyframe
   * @param {number} side Metres.
   * @returns {Array<[number, number]>} lat, lng: top left (in W, y up), top right, bottom right, bottom left.
   */
  square(keyframe, side) {
    const h = side / 2;
    const at = (/** @type {number} */ x, /** @type {number} */ y) => this.fromWorld(keyframe, x, y);
    return [at(-h, h), at(h, h), at(h, -h), at(-h, -h)];
  }

  /** @param {Place} keyframe @returns {number} Heading, clockwise from up on the map, degrees. */
  heading({ properties }) {
    return this.local ? 90 - (properties.world_yaw_rad * 180) / Math.PI : properties.heading_deg;
  }
}
