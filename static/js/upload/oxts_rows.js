/** A georeference that lies elsewhere than the drive: rows of OXTS, a geo.csv, or the folder of a KITTI raw drive. */

/** Frame of the raw drive at which an odometry sequence begins, where that is not 0. */
const FIRST_FRAME = { "2011_09_30_drive_0028": 1100 }; // sequence 08

/** Path that a georeference from elsewhere gets in the drive. @param {string} name */
export const placeOf = (name) => `georeference/${name}`;

/** @param {File} file @returns {string | null} Why it cannot be one. */
export function georeferenceComplaint(file) {
  return /\.(txt|csv)(\.gz)?$/i.test(file.name)
    ? null
    : `${file.name}: expected a file of OXTS rows (.txt, .txt.gz) or a geo.csv.`;
}

/**
 * Write the OXTS files of a KITTI raw drive as one file with a row a frame, the first for frame 0 of the sequence.
 *
 * @param {import("./folder.js").Folder} folder What was picked: the raw drive, or its oxts/.
 * @param {(done: number, total: number) => void} [onProgress]
 * @returns {Promise<File>}
 */
export async function oxtsRows(folder, onProgress = () => {}) {
  const found = [...folder.files].flatMap(([path, file]) => {
    const match = /^(?:(?:.*\/)?oxts\/)?(?:data\/)?(\d+)\.txt$/.exec(path);
    return match && !/(^|\/)(image_\d\d|velodyne_points)\//.test(path)
      ? [{ number: Number(match[1]), path, file }]
      : [];
  });
  const places = new Set(found.map(({ path }) => path.slice(0, path.lastIndexOf("/") + 1)));
  if (places.size > 1)
    throw new Error(
      `${folder.name} holds several OXTS folders (${[...places].slice(0, 3).join(", ")}): pick one drive.`,
    );
  found.sort((a, b) => a.number - b.number);
  if (!found.length || found.some(({ number }, i) => number !== i)) {
    const what = found.length ? "frames are missing among its OXTS files" : "no OXTS file is in it";
    throw new Error(`${folder.name}: ${what}. Expected a KITTI raw drive with oxts/data/0000000000.txt and on.`);
  }
  const drive = `${folder.name}/${found[0].path}`;
  const first = Object.entries(FIRST_FRAME).find(([name]) => drive.includes(name))?.[1] ?? 0;
  const rows = [];
  for (const { file } of found.slice(first)) {
    rows.push((await file.text()).trim().replaceAll(/\s+/g, " "));
    if (rows.length % 200 === 0) onProgress(rows.length, found.length - first);
  }
  return new File([`${rows.join("\n")}\n`], `${folder.name}.oxts.txt`, { lastModified: found[0].file.lastModified });
}
