/** Work of the service on a drive that the page waits for: unpacking an archive, checking and reducing. */

import { ApiError, sleep } from "../api.js";

/** @typedef {import("./transfer.js").Transfer} Transfer */

const WAIT_S = 3;
const POLL_MS = 700;

/**
 * Commit a drive, and tell how far the service is.
 *
 * @param {Transfer} transfer
 * @param {object} request Body of the commit.
 * @param {(job: any) => void} onProgress
 * @returns {Promise<any>} The drive, ready.
 * @throws {ApiError} With all problems of the drive.
 */
export async function checkAndKeep(transfer, request, onProgress) {
  for (;;) {
    await transfer.turn();
    const { status, body } = await transfer.ask(`drives/${transfer.drive}/commit`, {
      method: "POST",
      json: request,
      headers: { Prefer: `wait=${WAIT_S}` }, // the same commit again joins the one that runs
    });
    if (status !== 202) return body;
    const job = await latestWork(transfer, "commit");
    if (job) onProgress(job);
  }
}

/**
 * Wait until the service has done a piece of work on the drive, if it has any to do.
 *
 * @param {Transfer} transfer
 * @param {"unpack" | "commit"} kind
 * @param {(job: any) => void} onProgress
 * @throws {ApiError} In the words of the work that failed.
 */
export async function waitForWork(transfer, kind, onProgress) {
  for (;;) {
    const job = await latestWork(transfer, kind);
    if (!job || job.state === "successful") return;
    if (job.state === "failed" || job.state === "dismissed") {
      throw new ApiError(job.error?.status ?? 422, job.error ?? { title: "Stopped", detail: "The work was stopped." });
    }
    onProgress(job);
    await sleep(POLL_MS, transfer.signal);
    transfer.signal.throwIfAborted();
  }
}

/** @param {Transfer} transfer @param {"unpack" | "commit"} kind @returns {Promise<any>} */
async function latestWork(transfer, kind) {
  const { body } = await transfer.ask(`jobs?drive=${transfer.drive}&kind=${kind}&limit=1`);
  return body.jobs[0] ?? null;
}
