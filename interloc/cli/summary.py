"""What the commands print about a run and its evaluation."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from interloc.wording import counted, metres, percent

if TYPE_CHECKING:
    from interloc.results import DriveResult


def run_facts(result: DriveResult, out: Path) -> list[tuple[str, str]]:
    """Return names and values for a person."""
    run = result.run
    seconds, workers = run["seconds"], counted(run["workers"], "worker")
    return [
        (
            "drive",
            f"{result.drive}: {run['scans']} scans, {run['keyframes']} keyframes, preset {run['config']['preset']}",
        ),
        ("detections", f"{len(result.detections)}"),
        ("intersections", f"{len(result.intersections)} on the map"),
        *([("left out", _bends(run["bends"]))] if "bends" in run else []),
        georeference_fact(run),
        (
            "time",
            f"{seconds:.1f} s, {1e3 * seconds / run['keyframes']:.1f} ms per keyframe, {workers}",
        ),
        ("written to", str(out)),
    ]


def _bends(count: int) -> str:
    return (
        f"{counted(count, 'place')} of which all detections together saw two branches only: a bend of a road, or "
        "a side street that was not seen"
    )


def doubt_facts(result: DriveResult) -> list[tuple[str, str]]:
    """Return the warnings of doubtful labels and of lost scans, where there are any; a report holds them anyway."""
    from interloc.drives.folder import dropped_in_words
    from interloc.labelling.track import doubts_in_words

    stretches, dropped = result.run["doubtful_labels_m"], result.run.get("dropped")
    found = [doubts_in_words(stretches)] if stretches else []
    return [("warning", each) for each in (*found, *([dropped_in_words(dropped)] if dropped else []))]


def georeference_fact(run: dict[str, Any]) -> tuple[str, str]:
    """Return where longitude and latitude of a run come from, for a person."""
    return "georeference", run["georeference"] or "none: positions are metres in the frame of the first scan"


def run_summary(result: DriveResult, out: Path) -> dict[str, Any]:
    """Return the same for a program."""
    return {
        "out": str(out),
        "drive": result.drive,
        "detections": len(result.detections),
        "intersections": len(result.intersections),
        "georeferenced": result.is_georeferenced,
        **{key: result.run[key] for key in ("scans", "keyframes", "seconds", "peak_memory_bytes")},
    }


def not_right(report: dict[str, Any]) -> str:
    """Return of which kinds the intersections are that are not right, with numbers; "" where all are."""
    from interloc.evaluation.reasons import KINDS

    kinds = {kind: count for kind, count in report.get("reasons", {}).get("intersections", {}).items() if count}
    meanings: dict[str, str] = dict(KINDS)  # type: ignore[arg-type]
    listed = sorted(kinds.items(), key=lambda row: -row[1])
    return "; ".join(f"{count} x {meanings.get(kind, kind)}" for kind, count in listed)


def report_facts(report: dict[str, Any], out: Path) -> list[tuple[str, str]]:
    """Return the main figures of report.json for a person, the map first."""
    kinds = not_right(report)
    return [
        ("map", report["map_line"]),
        ("policy", f"{report['policy']}: {counted(report['nodes_in_zone'], 'OSM node')} in the relevant zone"),
        *([("not right", f"{kinds} (in intersections)")] if kinds else []),
        (
            "detection level",
            f"ACE {metres(report['ace_m'])}, precision {percent(report['precision']['5.0'])}, "
            f"recall {percent(report['recall']['5.0'])} at D = 5 m: the paper's measure, of single keyframes"
            if report["ace_m"] is not None
            else "no detection was matched",
        ),
        *(("warning", text) for text in report["warnings"]),
        ("report", str(out / "report.html")),
    ]
