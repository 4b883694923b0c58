"""Machine code that is kept on disk."""

import os
import subprocess
import sys
from pathlib import Path

from interloc.kernels import forget_older_code


def test_code_of_before_any_kernel_changed_is_deleted(tmp_path: Path) -> None:
    ages = {
        "here/changed.py": 30,
        "here/__pycache__/changed.kernel-1.py311.nbi": 20,
        "there/caller.py": 10,
        "there/other.py": 50,  # no kernel is in it
        "there/__pycache__/caller.kernel-1.py311.nbi": 20,
        "there/__pycache__/caller.kernel-1.py311.1.nbc": 20,
        "there/__pycache__/caller.kernel-1.py311.2.nbc": 40,
        "there/__pycache__/caller.cpython-311.pyc": 20,
    }
    for name, changed in ages.items():
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch()
        os.utime(path, (changed, changed))
    forget_older_code(tmp_path)
    left = {str(path.relative_to(tmp_path)) for path in tmp_path.rglob("*.*")}
    assert left == {name for name, changed in ages.items() if changed != 20 or name.endswith(".pyc")}
    forget_older_code(tmp_path / "nothing")


def test_a_kernel_is_compiled_with_the_code_of_one_that_was_kept(tmp_path: Path) -> None:
    (tmp_path / "two.py").write_text(
        "from interloc.kernels import compiled\n"
        "@compiled\ndef double(number: int) -> int:\n    return 2 * number\n"
        "@compiled\ndef after(number: int) -> int:\n    return double(number) + 1\n"
    )
    code = "import two; print(two.{0}(3), sum(two.{1}.stats.cache_{2}.values()))"
    for words, printed in (
        (("double", "double", "misses"), "6 1"),
        (("after", "double", "hits"), "7 1"),
        (("after", "after", "hits"), "7 1"),
    ):
        ran = subprocess.run(
            [sys.executable, "-c", code.format(*words)], cwd=tmp_path, capture_output=True, text=True, check=True
        )
        assert ran.stdout.strip() == printed
