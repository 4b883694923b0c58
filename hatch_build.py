"""Build hook: brings the packages of the page into the wheel, from npm where `npm ci` was not run before."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface


class PagePackages(BuildHookInterface[Any]):
    """Runs npm in `static/`; without npm the wheel has no page, which `interloc serve` says."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Install the packages that the page names, unless they are there or a checkout is only linked to."""
        del build_data
        page = Path(self.root) / "static"
        if version == "editable" or (page / "node_modules" / "leaflet").is_dir():
            return
        npm = shutil.which("npm")
        if npm is None:
            self.app.display_warning("npm was not found: this build holds no page. The API and the command line work.")
            return
        done = subprocess.run(  # noqa: S603 - nothing of it comes from outside
            [npm, "ci", "--omit=dev", "--prefix", str(page)], capture_output=True, text=True, check=False
        )
        if done.returncode:
            self.app.abort(f"npm could not install the packages of the page (in {page}):\n{done.stderr.strip()}")
