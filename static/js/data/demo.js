/** The demo: a drive through a made-up town, made by the server, and its job. */
import { getJson, sendJson, sleep } from "../api.js";
import { news } from "../news.js";
import { setState } from "../state.js";
import { refreshLists, rememberDrive, rememberJob } from "./lists.js";

const POLL_MS = 1500;

/** @type {{isRunning: boolean, error: unknown, drive: string|null, fraction: number|null}} `fraction`: how much is made. */
export const demo = { isRunning: false, error: null, drive: null, fraction: null };

export function demoText() {
  const part = demo.fraction === null ? "" : ` ${Math.floor(100 * demo.fraction)} % of it is done.`;
  return `The server drives through a small made-up town: about a minute, longer on a busy machine.${part}`;
}

const changes = news();
export const onDemoChange = changes.hear;

/** Make the demo drive on the server, run it, show the job. */
export async function tryDemo() {
  if (demo.isRunning) return;
  change({ isRunning: true, error: null, drive: null, fraction: null });
  try {
    await run();
    change({ isRunning: false });
  } catch (error) {
    change({ isRunning: false, error });
  }
}

/** @param {Partial<typeof demo>} news */
function change(news) {
  Object.assign(demo, news);
  changes.tell();
}

async function run() {
  let drive = await sendJson("POST", "demo", undefined, { headers: { Prefer: "respond-async" } });
  change({ drive: drive.id });
  rememberDrive(drive);
  while (drive.state !== "ready") {
    await sleep(POLL_MS);
    const { jobs } = await getJson(`jobs?kind=demo&drive=${drive.id}`);
    change({ fraction: jobs[0]?.progress.fraction ?? null });
    drive = await getJson(`drives/${drive.id}`);
  }
  await refreshLists();
  const request = { drive_id: drive.id, osm: { file: "map.osm" }, policy: "drive", name: "Demo" };
  const job = await sendJson("POST", "jobs", request);
  rememberJob(job);
  setState({ drive: job.drive_id, job: job.id, panel: "result", frame: null, view: null });
}
