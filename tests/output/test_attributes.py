from pathlib import Path

from interloc.output.layers import DERIVED, LAYERS

PAGE = (Path(__file__).resolve().parents[2] / "docs/attributes.md").read_text()


def test_the_page_names_every_layer_and_property() -> None:
    for layer in (LAYERS | DERIVED).values():
        assert [name for name in (layer.name, *layer.fields) if f"`{name}`" not in PAGE] == []
