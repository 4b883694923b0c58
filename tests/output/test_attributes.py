from __future__ import annotations

from pathlib import Path

from interloc.output.attributes import render


def test_the_page_of_attributes_is_up_to_date() -> None:
    page = Path(__file__).resolve().parents[2] / "docs" / "attributes.md"
    assert page.read_text() == render(), "make attributes"
