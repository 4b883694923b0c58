"""`interloc info --settings`: the settings of a preset."""

from collections.abc import Callable

import pytest

from interloc.config import DEFAULT, PAPER, flatten, parse_config


@pytest.mark.parametrize(("arguments", "preset"), [([], DEFAULT), (["--preset", "paper"], PAPER)])
def test_the_output_is_the_preset(arguments: list[str], preset: object, interloc: Callable) -> None:
    outcome = interloc("info", "--settings", "--json", *arguments)
    assert outcome.code == 0
    assert parse_config(outcome.json) == preset


def test_every_setting_is_explained(interloc: Callable) -> None:
    said = interloc("info", "--settings", "--set", "branches.inner_widths=null").out
    assert "branches.inner_widths = null" in said
    names = {line.partition(" = ")[0] for line in said.splitlines() if not line.startswith(" ")}
    assert names >= {name for name, _ in flatten(DEFAULT.model_dump()) if name.count(".") == 1}


@pytest.mark.parametrize(
    ("setting", "says"),
    [
        ("bev.nope=1", "bev.nope"),
        ("bev.size_m=60", "branches.outer_radius_m (40.0) must be less than half of bev.size_m (60.0)"),
    ],
)
def test_a_setting_that_has_no_meaning_is_wrong_usage(setting: str, says: str, interloc: Callable) -> None:
    outcome = interloc("info", "--settings", "--set", setting)
    assert outcome.code == 2
    assert says in outcome.complaint
    assert not outcome.out
