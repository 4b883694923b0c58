"""After `warm_up` a run compiles nothing any more: no time that is reported holds the compiler."""

import subprocess
import sys

SCRIPT = """
import sys
from pathlib import Path
from interloc.config import preset
from interloc.detection.warm import warm_up
from interloc.drives.open import open_drive
from interloc.pipeline import detect
from tests.app.street import write_street

def compiled():
    kernels = [(m.__name__, name, value) for m in list(sys.modules.values()) if m.__name__.startswith("interloc.")
               for name, value in vars(m).items() if hasattr(value, "signatures")]
    return {(module, name, str(each)) for module, name, value in kernels for each in value.signatures}

drive = open_drive(write_street(Path(sys.argv[1]), 45))
for name in ("default", "paper"):
    warm_up(preset(name))
    before = compiled()
    assert len(detect(drive, preset(name)).detections)
    assert compiled() == before, compiled() - before
"""


def test_nothing_is_left_to_be_compiled(tmp_path: object) -> None:
    command = [sys.executable, "-c", SCRIPT, str(tmp_path)]
    run = subprocess.run(command, capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr
