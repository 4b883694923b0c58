import runpy
from pathlib import Path

DOCS = Path(__file__).resolve().parents[2] / "docs"


def test_the_page_of_attributes_is_up_to_date() -> None:
    render = runpy.run_path(str(DOCS / "attributes.py"))["render"]
    assert (DOCS / "attributes.md").read_text() == render(), "make attributes"
