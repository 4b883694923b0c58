/** Places and findings of a map of many drives: their signs, names and words. */
/**
 * Signs, their names and what they say, in the order in which they are drawn: what is worth a look lies above.
 * @type {Record<string, [name: string, hint: string]>}
 */
export const PLACE_SIGNS = {
  unscored: ["seen once", "Seen in one pass, or not compared with OpenStreetMap"],
  right: ["no finding", "Seen in several passes; no finding against OpenStreetMap"],
  outside: ["looked at", "Somebody has said what is there"],
  wrong: ["finding", "OpenStreetMap seems to be wrong here"],
  here: ["new", "Seen by later drives alone, or one of its branches was"],
  elsewhere: ["gone", "Not seen any more by later drives, or one of its branches was not"],
};

/**
 * The sign of a place of a map of many drives.
 * @param {number} passes That saw it.
 * @param {{verdict: string|null}|null} finding About it.
 * @param {boolean} isCompared Whether the map was compared with OpenStreetMap.
 * @returns {string}
 */
export function placeSign(passes, finding, isCompared) {
  if (finding) return finding.verdict ? "outside" : "wrong";
  return isCompared && passes > 1 ? "right" : "unscored";
}

/** @param {number[]} box West, south, east, north. @param {number} count Along each side. @returns {number[][]} Its parts. */
export function partsOf([west, south, east, north], count) {
  const [dx, dy] = [(east - west) / count, (north - south) / count];
  const each = [...Array(count).keys()];
  return each.flatMap((i) =>
    each.map((j) => [west + i * dx, south + j * dy, west + (i + 1) * dx, south + (j + 1) * dy]),
  );
}

/** @param {string} kind "missing_junction" @returns {string} "Missing junction" */
export const kindName = (kind) => `${kind[0].toUpperCase()}${kind.slice(1).replaceAll("_", " ")}`;

/** @param {any} change Of the layer `changes`. @returns {string} */
export const signOfChange = ({ properties }) => (properties.kind.startsWith("new_") ? "here" : "elsewhere");

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
