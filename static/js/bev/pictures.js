/**
 * Pictures of the steps at a keyframe, as the server draws them; the last ones are kept.
 * @module bev/pictures
 */
import { getJson, request } from "../api.js";

/** The steps in their order, as in the paper's Fig. 2. */
export const STEPS = [
  { layer: "bev", title: "BEV image", hint: "Cells of the bird’s eye view with enough road points." },
  { layer: "occupancy", title: "Road occupancy", hint: "Gaps closed, specks removed." },
  { layer: "centerline", title: "Centerline", hint: "Skeleton of the road without its spurs." },
  { layer: "candidates", title: "Candidates", hint: "Where the centerline branches." },
  { layer: "branches", title: "Branches", hint: "Lines along the branches; they meet in the intersection." },
  { layer: "all", title: "All together", hint: "Every step over the road." },
];

const KEPT = 120;
/** @type {Map<string, string>} */
const urls = new Map();

/**
 * @param {string} job
 * @param {number} frame
 * @param {string} layer
 * @param {AbortSignal} signal
 * @returns {Promise<string>} Address of the picture within the page.
 */
export async function loadPicture(job, frame, layer, signal) {
  const path = `jobs/${job}/keyframes/${frame}/bev.png?layer=${layer}`;
  let url = urls.get(path);
  if (!url) {
    const response = await request(path, { signal });
    url = URL.createObjectURL(await response.blob());
  }
  urls.delete(path);
  urls.set(path, url);
  if (urls.size > KEPT) {
    const [oldest] = urls;
    URL.revokeObjectURL(oldest[1]);
    urls.delete(oldest[0]);
  }
  return url;
}

/**
 * @param {string} job
 * @param {number} frame
 * @param {AbortSignal} signal
 * @returns {Promise<{corners_lonlat: number[][]|null, corners_world_m: number[][], layers: string[], resolution_m: number,
 *   size_px: number, candidates: any[]}>} Where the pictures lie; corners: top left, top right, bottom right, bottom left.
 */
export function loadGeometry(job, frame, signal) {
  return getJson(`jobs/${job}/keyframes/${frame}/bev`, { signal });
}
