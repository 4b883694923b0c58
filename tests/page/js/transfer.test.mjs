import assert from "node:assert/strict";
import { createHash } from "node:crypto";
import { test } from "node:test";

import { ApiError } from "../../../static/js/api.js";
import { Meter, Transfer } from "../../../static/js/upload/transfer.js";

/** A service that has some files, and takes others by `take`; returns what was sent to it, as [path, text]. */
function serve(present, take = () => 200) {
  const sent = [];
  globalThis.fetch = async () => new Response(JSON.stringify({ files: present, next: null }));
  globalThis.XMLHttpRequest = class {
    upload = {};
    open(_method, url) {
      this.path = url.pathname ?? new URL(url).pathname;
    }
    setRequestHeader() {}
    getResponseHeader() {
      return null;
    }
    async send(data) {
      sent.push([this.path, await new Response(data).text()]);
      this.status = take(sent.length);
      this.responseText = JSON.stringify({ title: "Refused", detail: "that is damaged" });
      this.onload();
      this.onloadend();
    }
  };
  return sent;
}

const itemOf = (path, text) => {
  const file = new File([text], path);
  return { path, file, size: file.size };
};

test("small files travel together with their digests, large ones alone, and none that is there", async () => {
  const there = { path: "there.txt", size_bytes: 3, sha256: createHash("sha256").update("abc").digest("hex") };
  const sent = serve([there, { ...there, path: "trusted.txt" }]);
  const transfer = new Transfer(() => {}, new Set(["trusted.txt"]));
  transfer.drive = "d1";
  const large = "x".repeat(1024 * 1024 + 1);
  const small = Array.from({ length: 60 }, (_, i) => itemOf(`velodyne/${i}.bin`, `scan ${i}`));
  const known = [itemOf("there.txt", "abc"), itemOf("trusted.txt", "abd")];
  let done = 0;
  await transfer.sendAll([...known, itemOf("map.osm", large), ...small], (count) => (done = count));
  assert.equal(done, 63);
  assert.equal(transfer.meter.sent, transfer.meter.total);
  assert.equal(transfer.meter.skipped, 6);
  const bundles = sent.filter(([path]) => path.endsWith("/drives/d1/scans"));
  const alone = sent.filter((each) => !bundles.includes(each)).map(([path, text]) => [path.split("/files/")[1], text]);
  assert.ok(bundles.length <= 20, String(bundles.length));
  const parts = bundles.flatMap(([, text]) => [
    ...text.matchAll(/filename="([^"]+)"\r\n(Content-Digest: .*)\r\n\r\n(.*)\r\n/g),
  ]);
  const texts = new Map([...parts.map(([, path, , text]) => [path, text]), ...alone]); // the last of a lane may be alone
  assert.deepEqual(texts, new Map([["map.osm", large], ...small.map(({ path }, i) => [path, `scan ${i}`])]));
  assert.ok(!parts.some(([, path]) => path === "map.osm"));
  for (const [, path, header, text] of parts) {
    const digest = createHash("sha256").update(text).digest("base64");
    assert.equal(header, `Content-Digest: sha-256=:${digest}:`, path);
  }
});

test("the first failure ends it, and is thrown", async () => {
  const sent = serve([], (count) => (count === 2 ? 422 : 200));
  const all = Array.from({ length: 400 }, (_, i) => itemOf(`velodyne/${i}.bin`, "scan"));
  await assert.rejects(
    new Transfer(() => {}).sendAll(all, () => {}),
    /that is damaged/,
  );
  assert.ok(sent.length < 20);
});

test("nothing is sent once it was stopped", async () => {
  const sent = serve([]);
  const transfer = new Transfer(() => {});
  const all = transfer.sendAll([itemOf("poses.txt", "1 0")], () => {});
  transfer.stop();
  await assert.rejects(all, { name: "AbortError" });
  assert.deepEqual(sent, []);
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

test("the meter tells speed and time left", () => {
  let now = 0;
  const meter = new Meter(() => now);
  Object.assign(meter, { total: 10_000, skipped: 2_000 });
  assert.equal(meter.speed, null);
  Object.assign(meter, { sent: 4_000 });
  now = 40_000;
  assert.equal(meter.speed, 100);
  assert.equal(meter.secondsLeft, 60);
  assert.equal(meter.fraction, 0.5);
});
