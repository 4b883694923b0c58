/** From metres to the map: offsets around a keyframe on the ellipsoid, or plain metres without georeference. */

/** @import { Place } from "./results.js" */

const A = 6378137;
const E2 = 0.00669437999014;

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

/** Semi-axes in sigmas of the ellipse that holds 95 % of a normal distribution in the plane. */
export const SIGMAS_95 = Math.sqrt(-2 * Math.log(0.05));

/**
 * The ellipse in which an intersection lies, from the covariance of its position.
 * @param {any} properties Of an intersection; a result of a version before covariances gives a circle.
 * @returns {{major: number, minor: number, bearing: number}} Semi-axes of one sigma in metres; bearing of the longer
 *   one, clockwise from north, radians in [0, pi).
 */
export function ellipseOf({ position_cov_m2, position_std_m }) {
  const variance = (position_std_m ?? 0) ** 2;
  const [east, both, north] = position_cov_m2 ?? [variance, 0, variance];
  const middle = (east + north) / 2;
  const half = Math.hypot((east - north) / 2, both);
  const bearing = Math.atan2(2 * both, north - east) / 2;
  return {
    major: Math.sqrt(middle + half),
    minor: Math.sqrt(Math.max(middle - half, 0)),
    bearing: bearing < 0 ? bearing + Math.PI : bearing,
  };
}
