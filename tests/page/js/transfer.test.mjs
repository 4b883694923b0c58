import assert from "node:assert/strict";
import { test } from "node:test";

import { ApiError } from "../../../static/js/api.js";
import { Meter, Transfer } from "../../../static/js/upload/transfer.js";

test("the first failure ends it, and is thrown", async () => {
  const transfer = new Transfer(() => {});
  let begun = 0;
  const work = async (item) => {
    begun += 1;
    if (item === 3) throw new Error("velodyne/000003.bin: is damaged");
    await new Promise((resolve) => setImmediate(resolve));
  };
  await assert.rejects(
    transfer.each(
      Array.from({ length: 100 }, (_, i) => i),
      2,
      work,
    ),
    /000003\.bin: is damaged/,
  );
  assert.ok(begun < 100);
});

test("stopping ends what is paused", async () => {
  const transfer = new Transfer(() => {});
  transfer.pause();
  const all = transfer.each([1, 2, 3], 2, async () => assert.fail("nothing may begin"));
  transfer.stop();
  await assert.rejects(all, { name: "AbortError" });
});

test("what may pass is tried again, and shown; what may not is not", async () => {
  const waits = [];
  const transfer = new Transfer(() => waits.push(transfer.waiting));
  let tries = 0;
  const result = await transfer.retry(async () => {
    tries += 1;
    if (tries === 1) throw new ApiError(503, { title: "Database busy", detail: "" }, 0);
    if (tries === 2) throw new ApiError(0, { title: "Server not reached" }, 0);
    return "sent";
  });
  assert.equal(result, "sent");
  assert.equal(tries, 3);
  assert.match(waits[0], /^Database busy\. Trying again in 0 s\.$/);
  assert.equal(transfer.waiting, null);

  let once = 0;
  const refused = transfer.retry(async () => {
    once += 1;
    throw new ApiError(409, { title: "Drive is ready", detail: "It takes no more files." });
  });
  await assert.rejects(refused, /takes no more files/);
  assert.equal(once, 1);
});

test("the meter computes speed and time left from the last seconds, not from the first", () => {
  let now = 0;
  const meter = new Meter(() => now);
  meter.total = 10_000;
  assert.equal(meter.speed, null);
  for (; now < 20_000; now += 1000) meter.add(10); // slow at first
  for (; now < 60_000; now += 1000) meter.add(100);
  assert.ok(Math.abs(meter.speed - 100) < 10, String(meter.speed));
  assert.ok(Math.abs(meter.secondsLeft - (10_000 - 4200) / meter.speed) < 1e-9);
  meter.skipped = 2_000;
  assert.ok(Math.abs(meter.fraction - 6200 / 12_000) < 1e-9);
  meter.add(-100); // a file that has to go again
  assert.equal(meter.sent, 4100);
  meter.restart();
  assert.equal(meter.secondsLeft, null);
});
