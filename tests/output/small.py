"""A result that can be checked by eye, and its map."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np

from interloc.evaluation.evaluate import evaluate
from interloc.evaluation.report import write_report
from interloc.osm.reader import read_osm
from interloc.output.write import write_results
from interloc.results import DetectionTable, DriveResult, IntersectionTable, KeyframeTable, RoadPatch

TIME_S = np.array([1317386459.1234, 1317386461.0])

MAP = """<osm version="0.6"><bounds minlat="49.0" minlon="8.41" maxlat="49.03" maxlon="8.44"/>
<node id="9000000001" lat="49.0110001" lon="8.4205001"/><node id="2" lat="49.012" lon="8.4205"/>
<node id="3" lat="49.011" lon="8.422"/><node id="4" lat="49.011" lon="8.419"/>
<way id="10"><nd ref="4"/><nd ref="9000000001"/><nd ref="3"/><tag k="highway" v="residential"/></way>
<way id="11"><nd ref="9000000001"/><nd ref="2"/><tag k="highway" v="tertiary"/>
<tag k="name" v="Straße &amp; Weg"/></way>
</osm>"""


def small_result(*, local: bool = False, empty: bool = False) -> DriveResult:
    """Return two keyframes, two detections of one intersection and one of none; or keyframes that saw nothing."""
    count = 0 if empty else 3
    fixes = np.array([[8.4203, 49.0109], [8.4204, 49.01095]])
    seen = np.array([[8.4205, 49.011], [8.420502345, 49.010999876], [8.43, 49.02]])
    return DriveResult(
        drive="07",
        keyframes=KeyframeTable(
            frame=np.array([0, 12]),
            time_s=np.array([0.0, np.nan]),
            world_xy=np.array([[0.0, 0.0], [2.125, -1.0]]),
            world_yaw_rad=np.array([0.0, 0.5]),
            lonlat=None if local else fixes,
            enu_yaw_rad=None if local else np.array([math.pi / 2, math.pi]),
        ),
        detections=DetectionTable(
            keyframe=np.array([0, 1, 1])[:count],
            lidar_xy=np.array([[10.0, 1.0], [8.0, 2.0], [-3.5, 0.25]])[:count],
            world_xy=np.array([[10.0, 1.0], [10.1, 1.0], [0.0, -0.5]])[:count],
            lonlat=None if local else seen[:count],
            bearings_deg=[np.array([0.0, 90.0, 180.0]), np.array([1.0, 91.5, 181.25]), np.array([5.0, 6.0, 7.0])][
                :count
            ],
            score=np.array([1.0, 0.5, 0.125])[:count],
            intersection=np.array([0, 0, -1])[:count],
            widths_m=[np.full(3, np.nan)] * count,
            position_std_m=np.array([0.5, 0.25, 2.0])[:count],
        ),
        intersections=IntersectionTable(
            id=np.array([1])[:count],
            world_xy=np.array([[10.0625, 1.0]])[:count],
            lonlat=None if local else seen[:1][:count],
            position_std_m=np.array([0.25])[:count],
            observations=np.array([2])[:count],
            confidence=np.array([0.75])[:count],
            bearings_deg=[np.array([0.5, 90.75, 180.5])][:count],
            widths_m=[np.array([6.5, np.nan, 3.25])][:count],
            first_frame=np.array([0])[:count],
            last_frame=np.array([12])[:count],
            position_cov_m2=np.array([[0.0625, 0.03, 0.0625]])[:count],
        ),
        trajectory_world_xy=np.array([[0.0, 0.0], [2.125, -1.0]]),
        trajectory_lonlat=None if local else fixes,
        run={"config": {"preset": "paper"}, "peak_memory_mb": 12.5},
    )


def with_roads(result: DriveResult) -> DriveResult:
    """Return a result whose first keyframe saw, twice, two streets of 7 m that cross at its intersection."""
    cells = np.zeros((200, 200), np.uint8)
    cells[91:105], cells[:, 113:127] = 1, 1
    return replace(result, road=(RoadPatch.pack(0, np.array([-50.0, 50.0]), 0.5, cells),) * 2)


def write_folder(folder: Path, result: DriveResult, *, scored: bool, osm: str = MAP) -> Path:
    write_results(result, folder)
    if scored:
        place = folder.with_name(f"{folder.name}.place")  # of its own: folders that many tests share lie side by side
        place.mkdir(exist_ok=True)
        (place / "map.osm").write_text(osm)
        graph = read_osm(place / "map.osm")
        write_report(evaluate(result, graph), folder)
    return folder
