"""What jobs are called in lists: by their names, or by what was asked for other than the usual."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cache
from typing import Any

from app.jobs.models import NewJob
from app.states import JobKind
from app.store.models import Job
from interloc.config import PRESETS, flatten

_SYMBOLS = {
    "keyframes.distance_m": "keyframe distance",
    "keyframes.window": "n",
    "bev.size_m": "S",
    "bev.resolution_m": "r",
    "bev.min_points": "m",
    "branches.inner_radius_m": "a_i",
    "branches.outer_radius_m": "a_o",
    "branches.min_branches": "branches",
}
"""Short names of the settings that are changed most, those of the paper where it has one."""

_MAX_SETTINGS = 3  # in one title

_USUAL_LABELS = "labels"
_USUAL_POLICY = NewJob.model_fields["policy"].default
_USUAL_TOLERANCE_M = NewJob.model_fields["tolerance_m"].default
_OTHER_KINDS = {JobKind.COMMIT: "check", JobKind.UNPACK: "archive", JobKind.DEMO: "demo drive"}


def title_of(job: Job) -> str:
    """Return what a job is called: "default, predictions, r = 0.25"."""
    if job.kind != JobKind.INTERSECTIONS:
        return job.name or _OTHER_KINDS.get(JobKind(job.kind), job.kind)
    return job.name or ", ".join(_parts(job.request))


def distinct_titles(jobs: Sequence[Job]) -> list[str]:
    """Return names that tell jobs apart, in their order: what they all have in common is left out."""
    parts = [_parts(job.request) for job in jobs]
    names = _names_by(parts, jobs)
    if len(set(names)) < len(names):
        names = _names_by([[*own, *_map_file(job.request)] for job, own in zip(jobs, parts, strict=True)], jobs)
    return [f"{name} ({names[: i + 1].count(name)})" if names.count(name) > 1 else name for i, name in enumerate(names)]


def _names_by(parts: Sequence[Sequence[str]], jobs: Sequence[Job]) -> list[str]:
    shared = set(parts[0]).intersection(*parts[1:])
    return [
        job.name or ", ".join(part for part in own if part not in shared) or title_of(job)
        for job, own in zip(jobs, parts, strict=True)
    ]


def own_settings(request: dict[str, Any]) -> dict[str, Any]:
    """Return the settings of a request that differ from its preset, by their dotted names."""
    usual = _settings_of(_preset_of(request))
    own = flatten(request.get("config") or {})
    return {name: value for name, value in own if name != "preset" and (name not in usual or usual[name] != value)}


def _preset_of(request: dict[str, Any]) -> str:
    return str(request.get("preset") or (request.get("config") or {}).get("preset") or "default")


@cache
def _settings_of(preset: str) -> dict[str, Any]:
    return dict(flatten(PRESETS[preset].model_dump(mode="json"))) if preset in PRESETS else {}


def _parts(request: dict[str, Any]) -> list[str]:
    """Return what tells a job from the usual one, the preset first."""
    return [_preset_of(request), *_choices(request), *_settings(request)]


def _choices(request: dict[str, Any]) -> Iterator[str]:
    labels, osm, policy = (request.get(name) for name in ("labels", "osm", "policy"))
    if labels not in {None, _USUAL_LABELS}:
        yield labels
    if not osm:
        yield "no map"
        return
    if "overpass" in osm:
        yield "map by Overpass"
    if request.get("georeference") == "map":
        yield "placed by roads"
    if policy not in {None, _USUAL_POLICY}:
        tolerance_m = request.get("tolerance_m", _USUAL_TOLERANCE_M)
        is_usual = policy != "consolidated" or tolerance_m == _USUAL_TOLERANCE_M
        yield policy if is_usual else f"{policy} within {tolerance_m:g} m"


def _settings(request: dict[str, Any]) -> list[str]:
    own = [f"{_SYMBOLS.get(name, name)} = {_text(value)}" for name, value in own_settings(request).items()]
    if len(own) <= _MAX_SETTINGS:
        return own
    return [*own[: _MAX_SETTINGS - 1], f"{len(own) - _MAX_SETTINGS + 1} more settings"]


def _map_file(request: dict[str, Any]) -> list[str]:
    file = (request.get("osm") or {}).get("file")
    return [] if file is None else [str(file)]


def _text(value: object) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:g}"
    return "none" if value is None else str(value)
