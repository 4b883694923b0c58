/**
 * The demo: a drive that the server makes up, then a job with its map.
 * @module drives/demo
 */
import { getJson, sendJson, sleep } from "../api.js";
import { refreshLists, rememberDrive, rememberJob } from "../data/lists.js";
import { setState } from "../state.js";

/** Make the demo drive, run it, show the job. */
export async function runDemo() {
  let drive = await sendJson("POST", "demo");
  rememberDrive(drive);
  while (drive.state !== "ready") {
    await sleep(1500);
    drive = await getJson(`drives/${drive.id}`);
  }
  await refreshLists();
  const job = await sendJson("POST", "jobs", {
    drive_id: drive.id,
    osm: { file: "map.osm" },
    policy: "drive",
    name: "Demo",
  });
  rememberJob(job);
  setState({ drive: drive.id, job: job.id, panel: "job", frame: null, view: null });
}
