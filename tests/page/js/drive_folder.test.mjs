import assert from "node:assert/strict";
import { test } from "node:test";

import { setConfig } from "../../../static/js/api.js";
import {
  checkDrive,
  estimateKeyframes,
  findDrives,
  noDriveReason,
  oxtsRows,
  runsOf,
  sampleOf,
} from "../../../static/js/upload/drive_folder.js";
import { fingerprintOf } from "../../../static/js/upload/memory.js";

setConfig({
  file_kinds: {
    maps: [".osm", ".osm.gz", ".osm.bz2", ".osm.pbf"],
    archives: [".zip"],
    recordings: [".bag", ".db3", ".mcap", ".las", ".laz"],
    scans: [".pcd", ".pcd.bin"],
    label_fields: ["label", "class"],
  },
  limits: { max_file_bytes: 1000, max_recording_bytes: 2000, max_drive_bytes: 2500, max_drive_files: 10 },
  raw_first_frames: { "2011_09_30_drive_0028": 1100 },
});

const LABELLED = { model: "net", canLabel: true };
const POSE = "1 0 0 0 0 1 0 0 0 0 1 0\n";

/** A folder of files: path -> text, or number of bytes. */
function folder(files, name = "picked") {
  const content = (value) => (typeof value === "number" ? new Uint8Array(value) : value);
  const list = Object.entries(files).map(([path, value]) => [path, new File([content(value)], path.split("/").pop())]);
  return { name, files: new Map(list), handle: null };
}

/** Scans and labels of n points each. */
function scans(root, numbers, { bins = "velodyne", labels = "labels", points = 3, digits = 6 } = {}) {
  const files = {};
  for (const number of numbers) {
    const stem = String(number).padStart(digits, "0");
    files[`${root}${bins}/${stem}.bin`] = 16 * points;
    if (labels) files[`${root}${labels}/${stem}.label`] = 4 * points;
  }
  return files;
}

const texts = (problems, severity) =>
  problems.filter((each) => each.severity === severity).map((each) => `${each.path} ${each.message}`);

test("a SemanticKITTI sequence is found with all its parts", async () => {
  const [drive, ...others] = await findDrives(
    folder(
      {
        ...scans("", [0, 1, 2]),
        "predictions/000000.label": 12,
        "predictions/000001.label": 12,
        "predictions/000002.label": 12,
        "poses.txt": POSE,
        "calib.txt": "Tr: 1",
        "times.txt": "0",
        "geo.csv": "frame",
        "map.osm.gz": "x",
        "image_2/000000.png": 100,
      },
      "07",
    ),
  );
  assert.equal(others.length, 0);
  assert.equal(drive.name, "07");
  assert.equal(drive.layout, "semantickitti");
  assert.deepEqual([...drive.scans.files.keys()], [0, 1, 2]);
  assert.equal(drive.scans.bytes, 3 * 48);
  assert.deepEqual(Object.keys(drive.labels), ["labels", "predictions"]);
  assert.deepEqual([...drive.small.keys()].sort(), ["calib.txt", "geo.csv", "poses.txt", "times.txt"]);
  assert.deepEqual([...drive.maps.keys()], ["map.osm.gz"]);
  assert.deepEqual(drive.unused, { files: 1, bytes: 100 });
  assert.deepEqual(checkDrive(drive, ["labels", "predictions"], false), []);
});

test("recordings that only the service reads are found with what lies beside them", async () => {
  const found = async (files) => {
    const [drive, ...others] = await findDrives(folder(files));
    assert.deepEqual(others, []);
    return [drive.layout, drive.root, [...drive.recorded.keys()], [...drive.small.keys()]];
  };
  assert.deepEqual(await found({ "a/drive_0.db3": 9, "a/drive_1.db3": 9, "a/metadata.yaml": "x", "a/notes.md": 1 }), [
    ...["rosbag", "a"],
    ["drive_0.db3", "drive_1.db3"],
    ["metadata.yaml"],
  ]);
  assert.deepEqual(await found({ "las/1.laz": 9, "las/2.LAZ": 9, "track.out": 9, "map.osm": "x" }), [
    ...["las", ""],
    ["las/1.laz", "las/2.LAZ"],
    ["track.out"],
  ]);
  for (const place of ["", "pcd/", "clouds/", "velodyne/", "velodyne_points/data/"]) {
    const files = {
      [`07/${place}a_1.pcd`]: 9,
      [`07/${place}a_2.pcd.bin`]: 9,
      "07/poses.tum": "x",
      "07/oxts/1.txt": "1",
    };
    assert.deepEqual(await found(files), [
      ...["pcd", "07"],
      [`${place}a_1.pcd`, `${place}a_2.pcd.bin`],
      ["poses.tum", "oxts/1.txt"],
    ]);
  }
  assert.equal((await found({ "drive.bag": 90, "map.pcd": 20 }))[0], "rosbag"); // the larger of two kinds
  assert.equal((await found({ ...scans("07/", [0]), "map.pcd": 20, "07/drive.bag": 90 }))[0], "semantickitti");
});

test("what is wrong with recordings is listed before anything is sent", async () => {
  const errors = async (files, folders = []) => {
    const [drive] = await findDrives(folder(files));
    return texts(checkDrive(drive, folders, false), "error");
  };
  const labels = { "labels/000000.label": 4 };
  assert.deepEqual(await errors({ "a.mcap": 9 }), []);
  assert.deepEqual(await errors({ "a.pcd": 9, "poses.txt": POSE, ...labels }, ["labels"]), []);
  assert.deepEqual(await errors({ "a.laz": 9, "track.csv": "time,x,y,z" }), []);
  assert.match((await errors({ "a.laz": 9, "times.txt": "1" }))[0], /trajectory is missing/);
  assert.match((await errors({ "a.pcd": 9 }))[0], /poses\.txt is missing/);
  assert.match(
    (await errors({ "a.mcap": 2001 }))[0],
    /a\.mcap is too large: it has 2\.0.kB, the service takes files of/,
  );
  assert.match((await errors({ "a.pcd": 1001, "poses.txt": POSE }))[0], /at most 1\.0.kB \(INTERLOC_MAX_FILE_BYTES\)/);
  assert.match((await errors({ "a_0.mcap": 1500, "a_1.mcap": 1500 }))[0], /files are too large together: 3\.0.kB/);
  assert.match(
    (await errors({ "a.mcap": 9, "b.mcap": 9 }))[0],
    /a\.mcap is not the only bag of the folder \(b\.mcap\)/,
  );
  assert.match((await errors({ "a.bag": 0 }))[0], /a\.bag is empty/);
  assert.match(
    (await errors({ "1.pcd": 9, "2.pcd": 9, "poses.txt": POSE, ...labels }, ["labels"]))[0],
    /labels has no labels for 1 of 2 scans/,
  );
});

test("PCD files without a field for the label are named before they are sent", async () => {
  const pcd = (fields) => `# .PCD v0.7\nVERSION 0.7\nFIELDS ${fields}\nDATA ascii\n`;
  const errors = async (files, folders = [], labelling = undefined) => {
    const [drive] = await findDrives(folder({ ...files, "poses.txt": POSE }));
    return texts(checkDrive(drive, folders, false, labelling), "error");
  };
  const bare = { "10.pcd": pcd("x y z Class"), "9.pcd": pcd("x y z intensity") }; // 9 is the first
  const [text, ...others] = await errors(bare);
  assert.match(
    text,
    /^9\.pcd has no label: its fields are x, y, z, intensity\. Expected one of label, class .*INTERLOC_MODELS/,
  );
  assert.deepEqual(others, []);
  assert.deepEqual(await errors({ "9.pcd": pcd("x y z Class") }), []);
  assert.deepEqual(await errors(bare, [], LABELLED), []);
  assert.deepEqual(await errors({ ...bare, "labels/000009.label": 4, "labels/000010.label": 4 }, ["labels"]), []);
  assert.match((await errors({ "9.pcd.bin": 9 }))[0], /^9\.pcd\.bin has no label: it holds no named fields/);
});

test("a drive without labels needs a network, or is told how labels are made", async () => {
  const [drive] = await findDrives(folder({ ...scans("", [0, 1], { labels: null }), "poses.txt": POSE }));
  const errors = (labelling) => texts(checkDrive(drive, [], false, labelling), "error");
  assert.deepEqual(errors({ model: "salsanext", canLabel: true }), []);
  assert.match(
    errors({ model: null, canLabel: false })[0],
    /any semantic segmentation.*interloc label.*INTERLOC_MODELS/,
  );
  assert.doesNotMatch(errors({ model: null, canLabel: true })[0], /INTERLOC_MODELS/);
});

test("the number of keyframes is estimated from the poses", async () => {
  const estimate = async (files) => {
    const [drive] = await findDrives(folder({ "0.pcd": 9, ...files }));
    return estimateKeyframes(drive, 2);
  };
  const kitti = Array.from({ length: 11 }, (_, i) => `1 0 0 ${i} 0 1 0 0 0 0 1 0`).join("\n");
  const tum = Array.from({ length: 11 }, (_, i) => `${i} 0 ${i} 0 0 0 0 1`).join("\n");
  assert.equal(await estimate({ "poses.txt": kitti }), 6);
  assert.equal(await estimate({ "poses.tum": `# time x y z\n${tum}` }), 6);
  assert.equal(await estimate({ "poses.txt": "x y z" }), null);
  assert.equal(await estimate({}), null);
});

test("several drives are told apart, each with its own files", async () => {
  const drives = await findDrives(
    folder({
      ...scans("sequences/00/", [0]),
      ...scans("sequences/07/", [0, 1]),
      "sequences/00/poses.txt": POSE,
      "sequences/07/calib.txt": "Tr: 1",
      "poses/07.txt": POSE,
      "README.md": "x",
    }),
  );
  assert.deepEqual(
    drives.map((drive) => [drive.root, drive.name, drive.scans.files.size]),
    [
      ["sequences/00", "00", 1],
      ["sequences/07", "07", 2],
    ],
  );
  assert.deepEqual([...drives[0].small.keys()], ["poses.txt"]);
  assert.deepEqual([...drives[1].small.keys()].sort(), ["calib.txt", "poses.txt"]); // that of KITTI odometry beside
  assert.match(drives[1].borrowed[0], /poses\/07\.txt is taken as poses\.txt/);
});

test("a KITTI raw drive takes the calibration of its day", async () => {
  const root = "2011_09_26_drive_0001_sync/";
  const [drive] = await findDrives(
    folder(
      {
        ...scans(root, [0, 1], { bins: "velodyne_points/data", labels: null, digits: 10 }),
        ...{ [`${root}labels/0000000000.label`]: 12, [`${root}labels/0000000001.label`]: 12 },
        [`${root}oxts/data/0000000000.txt`]: "1",
        [`${root}oxts/dataformat.txt`]: "lat",
        [`${root}velodyne_points/timestamps.txt`]: "t",
        "calib_imu_to_velo.txt": "R: 1",
        "calib_velo_to_cam.txt": "R: 1",
      },
      "2011_09_26",
    ),
  );
  assert.equal(drive.layout, "kitti_raw");
  assert.deepEqual([...drive.small.keys()].sort(), [
    "calib_imu_to_velo.txt",
    "calib_velo_to_cam.txt",
    "oxts/data/0000000000.txt",
    "oxts/dataformat.txt",
    "velodyne_points/timestamps.txt",
  ]);
  assert.deepEqual(texts(checkDrive(drive, ["labels"], false), "error"), []); // its poses come from OXTS
});

test("the root of KITTI-360 is its drives, each with its poses, OXTS and calibration", async () => {
  const names = ["2013_05_28_drive_0000_sync", "2013_05_28_drive_0002_sync"];
  const files = {
    "calibration/calib_cam_to_velo.txt": "1",
    [`data_poses/${names[1]}/poses.txt`]: `7 ${POSE}`,
    [`data_poses/${names[1]}/oxts/data/0000000000.txt`]: "48.9 8.4",
    [`data_poses_oxts/${names[1]}/oxts/timestamps.txt`]: "0",
    [`data_poses_oxts/${names[1]}/oxts/dataformat.md`]: "no",
  };
  for (const name of names) {
    const bins = "velodyne_points/data";
    Object.assign(files, scans(`data_3d_raw/${name}/`, [7, 8], { bins, labels: null, digits: 10 }));
  }
  const [first, second] = await findDrives(folder(files, "KITTI-360"));
  assert.deepEqual([first.name, second.name], names);
  assert.equal(second.layout, "kitti360");
  assert.deepEqual([...second.small.keys()].sort(), [
    "calibration/calib_cam_to_velo.txt",
    `data_poses/${names[1]}/oxts/data/0000000000.txt`,
    `data_poses/${names[1]}/oxts/timestamps.txt`,
    `data_poses/${names[1]}/poses.txt`,
  ]);
  assert.equal(await estimateKeyframes(second, 1), 1);
  const all = checkDrive(second, [], false, LABELLED);
  assert.deepEqual([...texts(all, "error"), ...texts(all, "note").filter((text) => text.startsWith("georef"))], []);
  const [, missing] = texts(checkDrive(first, [], false, LABELLED), "error")
    .join()
    .match(/(poses.txt is missing.*)/);
  assert.match(missing, /of KITTI-360 pick its root, which has data_poses\//);
  const poses = folder({ [`data_poses/${names[0]}/poses.txt`]: "1" }, "KITTI-360");
  assert.match(noDriveReason(poses), /holds poses but no scans: pick the root of KITTI-360/);
});

test("pose lines that start with the frame number are KITTI-360's", async () => {
  const [drive] = await findDrives(folder({ ...scans("", [4]), "poses.txt": `4 ${POSE}` }));
  assert.equal(drive.layout, "kitti360");
});

test("a reduced drive is sent as it is", async () => {
  const [drive] = await findDrives(
    folder({
      "reduced.json": "{}",
      "ground/labels/000000.ground": 30,
      "ground/predictions/000000.ground": 30,
      "poses.txt": POSE,
      "oxts/data/0.txt": "1",
    }),
  );
  assert.equal(drive.layout, "reduced");
  assert.equal(drive.ground.size, 2);
  assert.deepEqual([...drive.small.keys()].sort(), ["oxts/data/0.txt", "poses.txt", "reduced.json"]);
  assert.deepEqual(checkDrive(drive, [], false), []);
});

test("missing labels, poses and sizes that do not fit are listed before anything is sent", async () => {
  const files = { ...scans("", [0, 1, 2, 3]), "calib.txt": "Tr: 1" };
  delete files["labels/000002.label"];
  files["labels/000001.label"] = 8;
  files["velodyne/000003.bin"] = 50;
  const [drive] = await findDrives(folder(files));
  const problems = checkDrive(drive, ["labels"], false);
  const errors = texts(problems, "error");
  assert.equal(errors.length, 4);
  assert.match(errors[0], /labels\/000002\.label is missing: 1 of 4 scans/);
  assert.match(errors[1], /labels\/000001\.label 2 labels for 3 points in velodyne\/000001\.bin/);
  assert.match(errors[2], /velodyne\/000003\.bin 50 bytes, which is not a multiple of 16/);
  assert.match(errors[3], /poses\.txt is missing/);
  assert.match(texts(problems, "note")[0], /local metres/);
});

test("calibration is missed where the poses are those of a camera", async () => {
  const along = (row) => [0, 1, 2].map((x) => row.replace("x", x)).join("\n");
  const warnings = async (poses, more = {}) => {
    const [drive] = await findDrives(folder({ ...scans("", [0, 1, 2]), "poses.txt": poses, ...more }));
    return texts(checkDrive(drive, ["labels"], false), "warning");
  };
  assert.match((await warnings(along("1 0 0 0 0 1 0 0 0 0 1 x")))[0], /calib\.txt is missing.* poses of a camera/);
  assert.deepEqual(await warnings(along("1 0 0 x 0 1 0 0 0 0 1 0")), []);
  assert.deepEqual(await warnings(along("1 0 0 0 0 1 0 0 0 0 1 x"), { "calib.txt": "Tr: 1" }), []);
});

test("names that are not scan numbers are listed", async () => {
  const [drive] = await findDrives(
    folder({ ...scans("", [0, 1]), "velodyne/scan.bin": 16, "velodyne/7.bin": 16, "poses.txt": POSE }),
  );
  const errors = texts(drive.problems, "error");
  assert.match(errors[0], /velodyne\/scan\.bin is not named by its scan number/);
  assert.match(errors[1], /numbered differently from its neighbours/);
});

test("a folder that is not a drive is explained", async () => {
  for (const [files, words] of [
    [{ "000000.bin": 16 }, /the scans themselves: pick the folder above/],
    [{ "x/data.zip": 1 }, /holds an archive/],
    [{ "drive.mcap.zst": 1 }, /compressed as a whole: unpack it first/],
    [{ "labels/000000.label": 4 }, /labels but no scans/],
    [{}, /is empty/],
    [{ "a.txt": "x" }, /is not a drive/],
  ]) {
    const picked = folder(files);
    assert.deepEqual(await findDrives(picked), []);
    assert.match(noDriveReason(picked), words);
  }
});

test("ten thousand scans are sorted at once", async () => {
  const [drive] = await findDrives(
    folder(
      scans(
        "a/b/",
        Array.from({ length: 10_000 }, (_, i) => i),
        { points: 0 },
      ),
    ),
  );
  assert.equal(drive.scans.files.size, 10_000);
  assert.deepEqual(runsOf(drive.scans.files.keys()), [[0, 10_000]]);
  assert.deepEqual(runsOf([3, 4, 9]), [
    [3, 2],
    [9, 1],
  ]);
});

test("samples are spread from the first to the last", () => {
  assert.deepEqual(sampleOf([1, 2, 3]), [1, 2, 3]);
  assert.deepEqual(sampleOf(Array.from({ length: 101 }, (_, i) => i)), [0, 25, 50, 75, 100]);
  assert.deepEqual(sampleOf(Array.from({ length: 50 }, (_, i) => i)), [0, 12, 24, 37, 49]); // as numpy.round has it
  assert.deepEqual(sampleOf(Array.from({ length: 48 }, (_, i) => i)), [0, 12, 24, 35, 47]);
});

test("the fingerprint of a folder tells its files, whatever their order", () => {
  const file = (text, lastModified) => new File([text], "x", { lastModified });
  const files = [
    ["a", file("1", 5)],
    ["b", file("22", 6)],
  ];
  const mark = fingerprintOf(files);
  assert.equal(fingerprintOf([...files].reverse()), mark);
  assert.notEqual(
    fingerprintOf([
      ["a", file("1", 5)],
      ["b", file("22", 7)],
    ]),
    mark,
  );
  assert.notEqual(
    fingerprintOf([
      ["a", file("1", 5)],
      ["b", file("2", 6)],
    ]),
    mark,
  );
  assert.notEqual(
    fingerprintOf([
      ["a", file("1", 5)],
      ["c", file("22", 6)],
    ]),
    mark,
  );
});

test("the OXTS of a raw drive become one row per frame, from the first frame of the sequence", async () => {
  const raw = (name, count, from = 0) => ({
    name,
    handle: null,
    files: new Map(
      Array.from({ length: count }, (_, i) => {
        const path = `oxts/data/${String(i + from).padStart(10, "0")}.txt`;
        return [path, new File([`${i + from}  8.4\n`], "x")];
      }),
    ),
  });
  const rows = await (await oxtsRows(raw("2011_09_30_drive_0027_sync", 3))).text();
  assert.equal(rows, "0 8.4\n1 8.4\n2 8.4\n");
  const eighth = await (await oxtsRows(raw("2011_09_30_drive_0028_sync", 1103))).text();
  assert.equal(eighth, "1100 8.4\n1101 8.4\n1102 8.4\n");
  await assert.rejects(oxtsRows(raw("x", 3, 2)), /frames are missing/);
  await assert.rejects(oxtsRows(raw("x", 0)), /no OXTS file/);
});
