"""The settings of the method, their presets, and how they are changed."""

import json

import pytest

from interloc.config import (
    DEFAULT,
    PAPER,
    PRESETS,
    BevConfig,
    CrossingCandidates,
    HarrisCandidates,
    parse_config,
    preset,
    with_settings,
)
from interloc.errors import ConfigError

# --- presets ---------------------------------------------------------------------------------------------------------


def test_paper_has_the_parameters_of_table_1() -> None:
    paper = preset("paper")
    assert (paper.keyframes.distance_m, paper.keyframes.angle_deg, paper.keyframes.window) == (2.0, 5.0, 20)
    assert (paper.bev.size_m, paper.bev.resolution_m, paper.bev.min_points) == (120.0, 0.16, 5)
    assert (paper.branches.inner_radius_m, paper.branches.outer_radius_m) == (10.0, 40.0)


def test_paper_adds_nothing_to_the_method() -> None:
    assert PAPER.keyframes.after == 20  # as many keyframes after the current one as before
    assert not PAPER.bev.adaptive
    assert PAPER.centerline.spur_widths == 0
    assert isinstance(PAPER.candidates, HarrisCandidates)
    assert PAPER.candidates.merge_m == 10.0
    assert PAPER.branches.min_branches == 3
    assert PAPER.branches.inner_widths is None
    assert PAPER.branches.line == "start_and_mean"
    assert PAPER.branches.margin_m == 0
    assert PAPER.branches.min_surface_m2 == 0
    assert PAPER.occupancy.island_m2 == 0
    assert PAPER.compound is None


def test_preset_that_does_not_exist_is_refused_with_the_choice() -> None:
    with pytest.raises(ConfigError, match="there is no 'fast'; choose one of default, paper"):
        preset("fast")


@pytest.mark.parametrize("name", PRESETS)
def test_configuration_survives_json(name: str) -> None:
    config = preset(name)
    assert parse_config(json.loads(config.model_dump_json())) == config


@pytest.mark.parametrize("name", PRESETS)
def test_every_setting_is_described(name: str) -> None:
    for section in preset(name).__dict__.values():
        for field, about in getattr(type(section), "model_fields", {}).items():
            assert about.description or field == "kind", f"{type(section).__name__}.{field}"


def test_lookahead_is_the_window_unless_set() -> None:
    assert with_settings(DEFAULT, ["keyframes.window=7"]).keyframes.after == 7
    assert with_settings(DEFAULT, ["keyframes.window=7", "keyframes.lookahead=0"]).keyframes.after == 0


@pytest.mark.parametrize(("size_m", "resolution_m", "cells"), [(120, 0.16, 750), (120, 0.25, 480), (60, 0.3, 200)])
def test_cells_are_counted_without_rounding_errors(size_m: float, resolution_m: float, cells: int) -> None:
    assert BevConfig(size_m=size_m, resolution_m=resolution_m).cells == cells


# --- settings --------------------------------------------------------------------------------------------------------


def test_settings_replace_what_they_name_and_nothing_else() -> None:
    config = with_settings(DEFAULT, ["bev.resolution_m=0.25", "keyframes.lookahead=3", "bev.adaptive=false"])
    assert (config.bev.resolution_m, config.keyframes.lookahead, config.bev.adaptive) == (0.25, 3, False)
    back = ["bev.resolution_m=0.16", "keyframes.lookahead=null", "bev.adaptive=true"]
    assert with_settings(config, back) == DEFAULT
    assert with_settings(PAPER, ["bev.min_points=2", "bev.min_points=9"]).bev.min_points == 9
    for given in ("branches.line=least_squares", 'branches.line="least_squares"'):
        assert with_settings(PAPER, [given]).branches.line == "least_squares"
    with pytest.raises(ConfigError, match="block_px is a window around a pixel, so it must be odd, not 10"):
        with_settings(PAPER, ["candidates.block_px=10"])


@pytest.mark.parametrize(
    ("setting", "message"),
    [
        ("bev.resolution=0.25", "bev.resolution: .*did you mean bev.resolution_m.*interloc info --settings"),
        ("map.size_m=3", "there is no section 'map'; did you mean bev.size_m?"),
        ("bev.size_m.x=3", "there is no section 'bev.size_m'"),
        ("bev.resolution_m", "expected section.name=value, for example bev.resolution_m=0.25"),
        ("resolution_m=0.25", "expected section.name=value"),
        ("", "expected section.name=value"),
        ("=3", "expected section.name=value"),
        ("bev.=3", "bev.: there is no such setting"),
        ("bev=null", "bev: Input should be"),
        ("bev.resolution_m=fine", r"bev.resolution_m: Input should be a valid number.*\(found 'fine'\)"),
        ("bev.resolution_m=[0.25]", "bev.resolution_m: Input should be a valid number"),
        ("bev.resolution_m=NaN", "bev.resolution_m: Input should be"),
        ("bev.resolution_m=-1", r"greater than or equal to 0.05 \(found -1\)"),
        ("bev.resolution_m=2", "makes 60 cells per side; expected 64 to 4096. Raise resolution_m or lower size_m"),
        ("bev.size_m=1e9", "bev.size_m: Input should be less than or equal to 400"),
        ("bev.min_points=2.5", "bev.min_points: Input should be a valid integer"),
        ("bev.adaptive=perhaps", "bev.adaptive: Input should be a valid boolean"),
        ("keyframes.lookahead=501", "keyframes.lookahead: Input should be less than or equal to 500"),
        ("branches.line=curved", "branches.line: Input should be 'start_and_mean' or 'least_squares'"),
        ("branches.inner_radius_m=40", r"outer_radius_m \(40.0\) must be larger than inner_radius_m \(40.0\)"),
        ("branches.outer_radius_m=60", r"must be less than half of bev.size_m \(120.0\)"),
        ("candidates.kind=magic", "candidates.*'harris', 'crossing'"),
        ("candidates.k=0.05", "candidates.k: .*one of the preset paper: candidates.kind=harris"),  # Harris' own
        ("bev.size_m=" + "[" * 100_000, "bev.size_m"),
    ],
)
def test_setting_without_meaning_is_refused_by_name(setting: str, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        with_settings(DEFAULT, [setting])


def test_all_faults_are_named_at_once() -> None:
    with pytest.raises(ConfigError, match=r"keyframes\.distance_m.*; bev\.min_points.*"):
        with_settings(DEFAULT, ["bev.min_points=0", "keyframes.distance_m=-2"])


def test_body_that_is_no_object_is_refused() -> None:
    with pytest.raises(ConfigError, match="configuration: Input should be a valid dictionary"):
        parse_config([1, 2])


def test_configuration_from_before_a_section_opens_with_its_defaults() -> None:
    values = DEFAULT.model_dump(mode="json", exclude={"score": True, "fusion": True, "branches": {"min_reach_m"}})
    assert parse_config(values) == DEFAULT


def test_configuration_with_settings_that_have_gone_opens_without_them() -> None:
    values = DEFAULT.model_dump(mode="json")
    values["branches"] |= {"end_at_rejected": False, "fork_std_m": 0.8}
    values["candidates"]["merge_min_m"], values["score"]["rated_branch"] = 4.0, 3
    values["fusion"]["range_scale_m"] = 15.0
    assert parse_config(values, strict=True) == DEFAULT
    with pytest.raises(ConfigError, match=r"--set score.rated_branch=2: there is no such setting any more"):
        with_settings(DEFAULT, ["score.rated_branch=2"])


# --- kinds, and steps that may be left out ---------------------------------------------------------------------------


def test_new_kind_sets_its_section_back() -> None:
    assert with_settings(DEFAULT, ["candidates.kind=harris"]).candidates == HarrisCandidates()
    assert with_settings(PAPER, ["candidates.kind=crossing"]).candidates == CrossingCandidates()
    config = with_settings(PAPER, ["candidates.block_px=5"])
    assert with_settings(config, ["candidates.kind=harris"]) == config


@pytest.mark.parametrize(
    "settings",
    [["candidates.kind=harris", "candidates.block_px=5"], ["candidates.block_px=5", "candidates.kind=harris"]],
)
def test_fields_of_the_new_kind_can_be_set_in_any_order(settings: list[str]) -> None:
    assert with_settings(DEFAULT, settings).candidates == HarrisCandidates(block_px=5)


def test_step_beyond_the_paper_can_be_left_out_and_taken_back() -> None:
    without = with_settings(DEFAULT, ["compound=null"])
    assert without.compound is None
    back = with_settings(without, ["compound.separation_m=9"])
    assert back.compound.separation_m == 9
