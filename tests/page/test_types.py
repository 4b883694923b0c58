"""The modules of the page keep to the types of their JSDoc."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

STATIC = Path(__file__).resolve().parents[2] / "static"
TSC = STATIC / "node_modules" / "typescript" / "bin" / "tsc"
NODE = shutil.which("node")


@pytest.mark.skipif(NODE is None or not TSC.is_file(), reason="TypeScript is not installed: npm ci in static/")
def test_the_modules_of_the_page_are_typed() -> None:
    assert NODE is not None
    checked = subprocess.run([NODE, TSC], cwd=STATIC, capture_output=True, text=True, timeout=300, check=False)
    assert checked.returncode == 0, checked.stdout
