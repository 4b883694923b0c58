"""Find road intersections in LiDAR drives, map them, and score them against OpenStreetMap.

A drive as a whole::

    import interloc

    drive = interloc.open_drive("sequences/07", oxts="2011_09_30_drive_0027_sync")
    result = interloc.detect(drive)
    evaluation = interloc.evaluate(result, interloc.read_osm("map.osm.gz"))
    print(evaluation.ace_m, evaluation.precision, evaluation.recall)
    interloc.write_results(result, "out")
    interloc.write_report(evaluation, "out")
    intersections = evaluation.geodataframe("intersections")

Scan by scan, as a vehicle sees them; each keyframe is answered 20 keyframes (40 m) later, or at once with
`keyframes.lookahead` 0::

    for found in interloc.stream(drive):
        print(found.keyframe.frame, found.world_xy)

`stream` takes scans of your own too (`Scan`); `Detector` is the same without a loop: `push` for every scan, `finish`
for the last keyframes.

Functions
---------
open_drive, inspect_drive
    Open a drive; or list everything that is wrong with it.
detect, stream, Detector, Scan
    Find the intersections of a drive; or online.
preset, DetectorConfig
    The settings of the method.
roads
    The map of the roads that a drive saw: centrelines, widths, junctions, surface.
read_osm, locate, evaluate
    Read a map; place a drive on it that has no GNSS; score a result.
write_results, write_report, read_results, geodataframe
    Result folders, and layers of them.
merge, CityMap, write_city, read_city
    One map of many drives.
InterLocError
    What every error on purpose is; its text is for the user.
"""

import lazy_loader

# The public names stand in `__init__.pyi`. Each is imported when first asked for: the compiler behind the kernels alone
# takes half a second to load.
_import, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)


def __getattr__(name: str) -> object:
    if name == "__version__":
        from importlib.metadata import version  # noqa: PLC0415 - seldom asked for

        return version("interloc")
    return _import(name)
