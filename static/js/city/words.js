/** Findings and their verdicts in words. */

/** @param {import("../data/city.js").Precision} precision */
export function precisionText({ right, wrong, share, low, high }) {
  if (share === null || low === null || high === null) return "How many are right is not known yet.";
  const [at, least, most] = [share, low, high].map((each) => Math.round(100 * each));
  return `${right} of ${right + wrong} right: ${at} % (95 %: ${least} to ${most} %).`;
}

/**
 * The names of the streets at a place.
 * @param {string|null|undefined} ways Of OpenStreetMap with their tags, the nearest first.
 * @returns {string} "Bahnhofstraße / Am Markt"; empty where none has a name.
 */
export function streetsOf(ways) {
  const names = (ways ?? "").split("; ").flatMap((way) => / name=(.+?)(?= [\w:]+=|$)/.exec(way)?.[1] ?? []);
  return [...new Set(names)].slice(0, 2).join(" / ");
}
