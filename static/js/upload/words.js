/** Names and explanations that the form and the progress share. */

export const LAYOUTS = {
  semantickitti: "SemanticKITTI / KITTI odometry",
  kitti_raw: "KITTI raw",
  kitti360: "KITTI-360",
  reduced: "reduced drive",
};

export const POSE_FRAMES = {
  auto: "Tell by the motion",
  camera: "Camera (KITTI, SemanticKITTI)",
  lidar: "LiDAR (kiss-icp and others)",
};

/** How poses are named once they are known. */
export const POSE_OWNERS = { camera: "of the camera", lidar: "of the LiDAR", imu: "of the IMU", oxts: "from OXTS" };

export const SCHEMES = {
  auto: "Tell by the ids",
  semantickitti: "SemanticKITTI (road = 40, 60)",
  learning: "Learning ids 0–19 (road = 9)",
  kitti360: "KITTI-360 (road = 7)",
  custom: "My own ids of road …",
};

export const POLICIES = {
  drive: ["Roads to drive on", "Nodes where three or more roads for cars meet; service ways do not count."],
  "drive+service": ["… and service ways", "Also driveways, lanes of car parks and alleys."],
  all: ["All ways", "Also footpaths, cycleways and tracks: many more nodes, much lower recall."],
  consolidated: ["Roads, nodes merged", "As the first, with nodes of one junction merged into one."],
};

export const SENDING = {
  keyframes: ["What the method needs", "The ground points of keyframes: the smallest, with the same results."],
  scans: ["Ground points of every scan", "For jobs with denser keyframes later on."],
  raw: ["Everything as it is", "All scans whole; the service reduces them after it has checked them."],
};

export const LABEL_FOLDERS = { labels: "labels (by hand)", predictions: "predictions (of a network)" };

export const STEPS = {
  files: "Small files",
  archive: "Archive",
  plan: "Plan",
  scans: "Scans",
  check: "Check",
  run: "Job",
};

export const EXAMPLE = `07/
  velodyne/000000.bin, 000001.bin, …
  labels/000000.label, …     or predictions/
  poses.txt   calib.txt   times.txt
  oxts/data/… or geo.csv     optional
  map.osm.gz                 optional`;
