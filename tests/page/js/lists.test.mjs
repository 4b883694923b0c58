import assert from "node:assert/strict";
import { test } from "node:test";

import { demo, tryDemo } from "../../../static/js/data/demo.js";
import { flatten, lists, onListsChange, refreshLists, rememberJob, titleOf } from "../../../static/js/data/lists.js";
import { nest } from "../../../static/js/job/job_form.js";
import { freeName } from "../../../static/js/job/run_dialog.js";

/** A server of 250 drives, the newest first, that notes what it was asked for. */
const server = { drives: Array.from({ length: 250 }, (_, i) => ({ id: `d${i}`, name: "a" })), asked: [] };
const answer = async (address) => {
  const url = new URL(address);
  const [what] = url.pathname.split("/").slice(-1);
  const [limit, after] = [Number(url.searchParams.get("limit")), Number(url.searchParams.get("after") ?? 0)];
  server.asked.push(`${what} ${after}`);
  const rows = what === "drives" ? server.drives : [];
  const next = after + limit < rows.length ? String(after + limit) : null;
  return Response.json({ [what]: rows.slice(after, after + limit), next });
};

/** @param {() => Promise<void>} call @returns {Promise<string[]>} What was asked for. */
const asks = async (call) => {
  globalThis.fetch = answer;
  server.asked = [];
  await call();
  return server.asked;
};

test("the newest drives are shown first, and a look asks for no more while nothing happens to them", async () => {
  const seen = [];
  onListsChange(() => seen.push([lists.drives.length, lists.isWhole]));
  const heads = ["drives 0", "jobs 0"];
  assert.deepEqual(await asks(() => refreshLists()), [...heads, "drives 100"]);
  assert.deepEqual(seen, [
    [100, false],
    [250, true],
  ]);
  assert.deepEqual(await asks(() => refreshLists(true)), heads);
  assert.deepEqual(await asks(() => refreshLists()), [...heads, "drives 100"]);
  assert.equal(seen.length, 2); // nothing new, nothing drawn anew

  server.drives[200] = { id: "d200", name: "renamed" };
  await refreshLists(true);
  assert.equal(lists.drives[200].name, "a"); // found by the next look at everything
  server.drives.unshift({ id: "new", name: "a" });
  assert.deepEqual(await asks(() => refreshLists(true)), [...heads, "drives 100"]);
  assert.deepEqual([lists.drives.length, lists.drives[0].id, lists.drives[201].name], [251, "new", "renamed"]);
  assert.equal(lists.isCut, false);
});

test("the drive of the demo is known as such when the list has it", async () => {
  globalThis.fetch = async (address) =>
    Response.json({ id: "made", state: "ready" }, { status: address.endsWith("/demo") ? 200 : 500 });
  const seen = [];
  onListsChange(() => seen.push([lists.drives[0].id, demo.drive]));
  await tryDemo(); // nothing else is answered
  assert.deepEqual(seen[0], ["made", "made"]);
});

test("jobs of a drive on different maps are told apart by them", () => {
  const job = (id, file, more = {}) => ({
    id,
    drive_id: "d1",
    title: "default",
    version: 1,
    request: { osm: { file } },
    ...more,
  });
  const [one, other] = [job("a", "00.osm.gz"), job("b", "00.osm.gz")];
  for (const each of [one, other, job("c", "new.osm", { drive_id: "d2" })]) rememberJob(each);
  assert.equal(titleOf(one), "default");
  rememberJob(job("e", "04.osm.gz"));
  assert.equal(titleOf(one), "default, 00.osm.gz");
  assert.equal(titleOf(job("c", "new.osm", { drive_id: "d2" })), "default");
  assert.equal(titleOf(job("f", "00.osm.gz", { name: "mine", title: "mine" })), "mine");
  assert.equal(titleOf({ ...one, title: "default, no map", request: { osm: null } }), "default, no map");
});

test("a map that is sent does not take the place of one that the drive has", () => {
  assert.equal(freeName("town.osm.gz", []), "town.osm.gz");
  assert.equal(freeName("town.osm.gz", ["Town.osm.gz", "town-2.osm.gz"]), "town-3.osm.gz");
});

test("settings by path become those of sections again", () => {
  const config = { bev: { resolution_m: 0.25, size_m: 100 }, compound: null };
  assert.deepEqual(nest(flatten(config)), config);
});
