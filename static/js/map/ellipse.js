/** The ellipse in which an intersection lies, from the covariance of its position. */

/** Semi-axes in sigmas of the ellipse that holds 95 % of a normal distribution in the plane. */
export const SIGMAS_95 = Math.sqrt(-2 * Math.log(0.05));

/**
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
