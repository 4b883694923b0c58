import assert from "node:assert/strict";
import { test } from "node:test";
import { setConfig } from "../../../static/js/api.js";
import { inForm } from "../../../static/js/controls.js";
import { driveOf, lookInto, numberedFiles, numbersOf, problemsOf } from "../../../static/js/upload/drive_folder.js";

setConfig({
  file_kinds: {
    maps: [".osm", ".osm.gz"],
    archives: [".zip"],
    recordings: [".bag"],
    scans: [".pcd"],
    small: [".txt", ".csv"],
  },
});

/** A folder of files: path -> text, or number of bytes. */
function folder(files, name = "picked") {
  const content = (value) => (typeof value === "number" ? new Uint8Array(value) : value);
  const list = Object.entries(files).map(([path, value]) => [path, new File([content(value)], path.split("/").pop())]);
  return { name, files: new Map(list) };
}

const LOOK = {
  ...{ root: "07", name: "07", layout: "semantickitti", scans: null, labels: {}, whole: {}, small: {}, wanted: {} },
  ...{
    problems: [],
    unlabelled: [],
    georeference_reason: null,
    track: null,
    frames_to_look_into: [],
  },
};
const numbered = (name, suffix, runs) => ({ folder: name, suffix, digits: 6, runs });

/** Let the service answer what is given; returns what it was asked. */
function serve(...answers) {
  const asked = [];
  globalThis.fetch = async (_address, { body }) => {
    asked.push(JSON.parse(body));
    const answer = answers.shift();
    if (answer instanceof Error) throw answer;
    return new Response(JSON.stringify(answer));
  };
  return asked;
}

test("the files of a drive are those that the service names", () => {
  const files = { "07/velodyne/000000.bin": 48, "07/velodyne/000004.bin": 32, "07/labels/000000.label": 12 };
  const small = { "07/poses.txt": "x", "poses/07.txt": "yy", "07/map.osm": "m", "07/image_2/0.png": 100 };
  const drive = driveOf(folder({ ...files, ...small, "README.md": 5 }), {
    ...LOOK,
    scans: numbered("velodyne", ".bin", [
      [0, 1],
      [4, 1],
    ]),
    labels: { labels: { ...numbered("labels", ".label", [[0, 1]]), problems: [] } },
    small: { "poses.txt": "poses/07.txt", "georeference/from elsewhere.txt": "07/georeference/from elsewhere.txt" },
  });
  assert.deepEqual(numbersOf(drive.look.scans.runs), [0, 4]);
  const pathsOf = (numbered) => numberedFiles(drive, numbered).map(([path]) => path);
  assert.deepEqual(pathsOf(drive.look.scans), ["velodyne/000000.bin", "velodyne/000004.bin"]);
  assert.deepEqual(pathsOf(drive.look.labels.labels), ["labels/000000.label"]);
  assert.deepEqual(
    [...drive.small].map(([path, { size }]) => [path, size]),
    [["poses.txt", 2]],
  );
  assert.deepEqual([...drive.maps.keys()], ["map.osm"]);
  assert.deepEqual(drive.unused, { files: 2, bytes: 101 }); // the picture, and poses that do not count
});

test("names, sizes and small files are sent, and then what is wanted", async () => {
  const whole = { ...LOOK, layout: "pcd", whole: { "9.pcd": "07/9.pcd" } };
  const answer = (wanted) => ({ drives: [], drive: { ...whole, wanted }, reason: null });
  const asked = serve(answer({ "07/9.pcd": 4 }), answer({}));
  const files = folder({ "07/9.pcd": "FIELDS", "07/poses.txt": "1 0", "07/a.png": 9 });
  const { drive } = await lookInto(files, { root: "07", extras: new Map([["geo.csv", new File(["f"], "geo.csv")]]) });
  assert.deepEqual(asked[0].files, { "07/9.pcd": 6, "07/poses.txt": 3, "07/geo.csv": 1 });
  assert.deepEqual(asked[0].contents, { "07/poses.txt": btoa("1 0"), "07/geo.csv": btoa("f") });
  assert.deepEqual(asked[1].contents, { ...asked[0].contents, "07/9.pcd": btoa("FIEL") });
  assert.deepEqual([...drive.whole.keys()], ["9.pcd"]);
  assert.equal(asked.length, 2);
});

test("a folder that is no drive is explained by the service", async () => {
  serve({ drives: [], drive: null, reason: "picked is empty." });
  assert.deepEqual(await lookInto(folder({})), { drives: [], drive: null, reason: "picked is empty." });
});

test("label ids are counted in the scans that the service names", async () => {
  const labels = { labels: { ...numbered("labels", ".label", [[0, 2]]), problems: [] } };
  const answer = { drives: [], drive: { ...LOOK, labels, frames_to_look_into: [0, 1] }, reason: null };
  const asked = serve(answer, answer);
  const ids = (...values) => new Uint8Array(new Uint32Array(values).buffer);
  const names = ["07/labels/000000.label", "07/labels/000001.label"];
  const files = new Map(names.map((name, i) => [name, new File([ids(40, 70, 40 + 10 * i)], name)]));
  await lookInto({ name: "picked", files }, { root: "07" });
  assert.deepEqual(asked[1].label_counts, { labels: { 40: 3, 50: 1, 70: 2 } });
  assert.equal(asked.length, 2);
});

test("labels count where they are sent, and their lack where the service makes none", () => {
  const [bad, none] = ["bad labels", "no labels"].map((message) => ({ severity: "error", path: "labels", message }));
  const texts = (drive, folders, labelling) => problemsOf(drive, folders, labelling).map(({ message }) => message);
  const look = { ...LOOK, unlabelled: [none], labels: { labels: { problems: [bad] } } };
  const labelled = { look };
  assert.deepEqual(texts(labelled, ["labels"], false), ["bad labels"]);
  assert.deepEqual(texts(labelled, [], false), []);
  const bare = { look: { ...look, labels: {} } };
  assert.deepEqual(texts(bare, [], true), []);
  assert.deepEqual(texts(bare, [], false), ["no labels"]);
  const local = { look: { ...look, georeference_reason: "there is no oxts/" } };
  assert.match(texts(local, [], false)[0], /there is no oxts\/.*local metres/);
});

test("texts of the server name the fields of the form", () =>
  assert.equal(inForm("`x --poses F` (--label-scheme 7) --x"), "`x --poses F` (“What the ids of labels mean” 7) --x"));
