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
        georeference_fact(run),
        (
            "time",
            f"{seconds:.1f} s, {1e3 * seconds / run['keyframes']:.1f} ms per keyframe, {workers}",
        ),
        ("written to", str(out)),
    ]


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


def wrong_detections(report: dict[str, Any]) -> tuple[int, str]:
    """Return how many detections are wrong, and of which kinds: what mean error and precision come from."""
    from interloc.evaluation.reasons import KINDS

    kinds = {kind: count for kind, count in report.get("reasons", {}).get("detections", {}).items() if count}
    meanings: dict[str, str] = dict(KINDS)  # type: ignore[arg-type]
    listed = sorted(kinds.items(), key=lambda row: -row[1])
    return sum(kinds.values()), "; ".join(f"{count} x {meanings.get(kind, kind)}" for kind, count in listed)


def report_facts(report: dict[str, Any], out: Path) -> list[tuple[str, str]]:
    """Return the main figures of report.json for a person, the map first."""
    wrong, kinds = wrong_detections(report)
    return [
        *([("map", report["map_line"])] if "map_line" in report else []),  # servers of older versions do not send it
        ("policy", f"{report['policy']}: {counted(report['nodes_in_zone'], 'OSM node')} in the relevant zone"),
        ("by detections", f"{report['nodes_found']} of {report['nodes_in_zone']} nodes have one within 5 m"),
        (
            "center error",
            f"{metres(report['ace_m'])} mean (ACE), {metres(report['median_m'])} median"
            if report["ace_m"] is not None
            else "none: no detection was matched",
        ),
        ("at D = 5 m", f"precision {percent(report['precision']['5.0'])}, recall {percent(report['recall']['5.0'])}"),
        *([("wrong", f"{counted(wrong, 'detection')}: {kinds}")] if wrong else []),
        *(("warning", text) for text in report["warnings"]),
        ("report", str(out / "report.html")),
    ]
