"""Where the files of the page are, and which of them may be seen."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import app
from app.http.delivery import MEDIA_TYPES
from app.settings import Settings

INDEX = "index.html"
_PACKAGES = "node_modules"
_PRIVATE = frozenset({"package.json", "package-lock.json"})


@dataclass(frozen=True)
class Assets:
    """The files of the page.

    Attributes
    ----------
    root : Path
        Folder of `index.html`.
    packages : frozenset of str
        npm packages that the page names as its dependencies; no other one is served.
    """

    root: Path
    packages: frozenset[str]

    @classmethod
    def find(cls, settings: Settings) -> Assets:
        """Find the page: where the settings say, beside the package (a checkout), or in it (an installation)."""
        package = Path(app.__file__).parent
        places = [settings.static_dir] if settings.static_dir else [package.parent / "static", package / "static"]
        root = next((place for place in places if (place / INDEX).is_file()), places[0]).resolve()
        try:
            dependencies = json.loads((root / "package.json").read_bytes()).get("dependencies", {})
        except (OSError, ValueError):
            dependencies = {}
        return cls(root, frozenset(dependencies))

    @property
    def is_complete(self) -> bool:
        """Whether the page and the packages that it needs are there."""
        return (self.root / INDEX).is_file() and all((self.root / _PACKAGES / p).is_dir() for p in self.packages)

    def find_file(self, name: str) -> Path | None:
        """Return a file that may be served, by its path below the root."""
        parts = name.split("/")
        if "\0" in name or name in _PRIVATE or any(not part or part.startswith(".") for part in parts):
            return None
        if parts[0] == _PACKAGES and self.packages.isdisjoint(parts[1:2]):
            return None
        path = self.root.joinpath(*parts)
        if path.suffix not in MEDIA_TYPES or not path.is_file() or not path.resolve().is_relative_to(self.root):
            return None
        return path
