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
        """Install the packages that the page names, unless they are there, and bundle it; a linked checkout stays."""
        del build_data
        page = Path(self.root) / "static"
        if version == "editable":
            return
        has_packages = (page / "node_modules" / "leaflet").is_dir()
        npm = shutil.which("npm")
        if npm is None:
            if not has_packages:
                warning = "npm was not found: this build holds no page. The API and the command line work."
                self.app.display_warning(warning)
            return

        def run(*command: str) -> subprocess.CompletedProcess[str]:
            return subprocess.run(  # noqa: S603 - nothing of it comes from outside
                [npm, *command, "--prefix", str(page)], capture_output=True, text=True, check=False
            )

        installed = None if has_packages else run("ci", "--omit=dev")
        if installed and installed.returncode:
            self.app.abort(f"npm could not install the packages of the page (in {page}):\n{installed.stderr.strip()}")
        bundled = run("run", "build")
        if bundled.returncode:
            warning = f"The page is not bundled, its modules are served as they are:\n{bundled.stderr.strip()}"
            self.app.display_warning(warning)
