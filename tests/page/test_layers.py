"""The modules of the page import downwards only, in the layers that `static/js/main.js` names; Biome finds circles."""

import re
from pathlib import Path

JS = Path(__file__).resolve().parents[2] / "static" / "js"
MAIN = JS / "main.js"


def layers() -> list[list[str]]:
    """Names of folders and single modules, the lowest first, from the comment of main.js."""
    listed = re.search(r"Layers, the lowest first;.*?:\n(.*?)\n \*/", MAIN.read_text(), re.DOTALL)
    assert listed is not None
    return [line.strip(" *").split() for line in listed[1].splitlines()]


def part_of(module: Path) -> str:
    """The folder of a module, or its own name."""
    return module.relative_to(JS).with_suffix("").parts[0]


def imports_of(module: Path) -> list[Path]:
    """Modules of the page that a module imports, at its top or later; not for types alone."""
    code = re.sub(r"/\*.*?\*/", "", module.read_text(), flags=re.DOTALL)
    paths = re.findall(r'(?:from|import|import\()\s*"(\.[^"]+\.js)"', code)
    paths += re.findall(r'new URL\("(\./[^"]+\.js)", import\.meta\.url\)', code)
    found = [(module.parent / path).resolve() for path in paths]
    return [path for path in found if "node_modules" not in path.parts]


def test_every_module_is_in_a_layer() -> None:
    named = [part for layer in layers() for part in layer]
    assert len(named) == len(set(named))
    assert set(named) == {part_of(module) for module in JS.rglob("*.js")}


def test_no_module_imports_from_a_layer_beside_or_above_its_own() -> None:
    rank = {part: number for number, layer in enumerate(layers()) for part in layer}
    upward = [
        f"{module.relative_to(JS)} imports {imported.relative_to(JS)}"
        for module in sorted(JS.rglob("*.js"))
        for imported in imports_of(module)
        if part_of(imported) != part_of(module) and rank[part_of(imported)] >= rank[part_of(module)]
    ]
    assert upward == []
