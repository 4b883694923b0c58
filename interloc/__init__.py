"""Find road intersections in LiDAR drives, map them, and score them against OpenStreetMap.

import interloc

drive = interloc.open_drive("sequences/07", oxts="2011_09_30_drive_0027_sync")
result = interloc.detect(drive)                                   # offline, the whole drive
evaluation = interloc.evaluate(result, interloc.read_osm("map.osm.gz"))

detector = interloc.Detector()                                    # online, scan by scan
detections = detector.push(interloc.Scan(frame, T_world_lidar, road_points))
"""

import lazy_loader

# The public names stand in `__init__.pyi`. Each is imported when first asked for: the compiler behind the kernels alone
# takes half a second to load.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
