"""Files of the page, and the documentation of the API: Swagger UI, from the npm package, not from other hosts."""

import hashlib
import json
import os
from contextlib import suppress
from pathlib import Path

import app
from app.http.delivery import MEDIA_TYPES
from app.settings import Settings

INDEX = "index.html"
VERSION_MARK = "@"
"""`static/@VERSION/js/main.js` is `static/js/main.js` of one version."""
_PACKAGES = "node_modules"
_BUNDLE = "bundle"

SWAGGER = "node_modules/swagger-ui-dist/swagger-ui-bundle.js"

# FastAPI's own page holds its start as a script within it, which the policy below does not allow.
SWAGGER_PAGE = """<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>InterLoc API</title>
<link rel="icon" href="static/icon.svg" type="image/svg+xml">
<link rel="stylesheet" href="static/node_modules/swagger-ui-dist/swagger-ui.css">
</head>
<body>
<div id="swagger-ui"></div>
<script src="static/node_modules/swagger-ui-dist/swagger-ui-bundle.js"></script>
<script src="docs/start.js"></script>
</body>
</html>
"""

SWAGGER_START = """SwaggerUIBundle({
  url: new URL("openapi.json", document.baseURI).href,
  dom_id: "#swagger-ui",
  deepLinking: true,
  displayRequestDuration: true,
  validatorUrl: null,
  presets: [SwaggerUIBundle.presets.apis, SwaggerUIBundle.SwaggerUIStandalonePreset],
});
"""

DOCS_POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self' 'unsafe-inline'; img-src 'self' data:; "
    "connect-src 'self'; frame-ancestors 'none'; base-uri 'none'; form-action 'none'"
)
"""Swagger UI writes style attributes; scripts come from this service only."""


class PageFiles:
    """The files of the page: where the settings say, beside the package (a checkout), or in it (an installation).

    `root` is the folder of `index.html`; `packages` are the npm packages that the page names as its dependencies, and
    no other one is served.
    """

    def __init__(self, settings: Settings) -> None:
        package = Path(app.__file__).parent
        self._bundled = "", False  # of which version of the files it is known
        places = [settings.static_dir] if settings.static_dir else [package.parent / "static", package / "static"]
        self.root = next((each for each in places if (each / INDEX).is_file()), places[0]).resolve()
        try:
            dependencies = json.loads((self.root / "package.json").read_bytes()).get("dependencies", {})
        except (OSError, ValueError):
            dependencies = {}
        self.packages = frozenset(dependencies)

    def are_complete(self) -> bool:
        """Tell whether the page and the packages that it needs are there."""
        return (self.root / INDEX).is_file() and all((self.root / _PACKAGES / p).is_dir() for p in self.packages)

    def is_bundled(self, version: str) -> bool:
        """Tell whether `npm run build` bundled the files as they are now: its source maps hold them."""
        if self._bundled[0] != version:
            self._bundled = version, self._is_current()
        return self._bundled[1]

    def _is_current(self) -> bool:
        try:
            maps = [json.loads(path.read_bytes()) for path in (self.root / _BUNDLE).glob("*.map")]
            sources = [pair for each in maps for pair in zip(each["sources"], each["sourcesContent"], strict=True)]
            own = [(self.root / _BUNDLE / name, text) for name, text in sources if f"/{_PACKAGES}/" not in name]
            return bool(own) and all(path.read_bytes().decode() == text for path, text in own)
        except (OSError, ValueError, LookupError, TypeError):
            return False

    def version(self) -> str:
        """Return what is another when any file of the page is: part of the addresses that browsers may keep."""
        named = [self.root / _PACKAGES / package / "package.json" for package in sorted(self.packages)]
        for folder, folders, names in os.walk(self.root):
            folders[:] = sorted(set(folders) - {_PACKAGES})
            named += [Path(folder, name) for name in sorted(names)]
        digest = hashlib.sha256()
        for path in named:
            with suppress(OSError):  # it is gone, or a link to nowhere
                stat = path.stat()
                digest.update(f"{path}:{stat.st_mtime_ns}:{stat.st_size}\n".encode(errors="surrogateescape"))
        return digest.hexdigest()[:12]

    def index(self) -> bytes:
        """Return the page, whose scripts and styles have the version in their addresses."""
        page, version = (self.root / INDEX).read_bytes(), self.version()
        if self.is_bundled(version):
            page = page.replace(b'"static/js/', b'"static/bundle/').replace(b'"static/css/', b'"static/bundle/')
        return page.replace(b'"static/', f'"static/{VERSION_MARK}{version}/'.encode())

    def find(self, name: str) -> Path | None:
        """Return a file that may be served, by its path below the root."""
        parts = name.split("/")
        if "\0" in name or any(not part or part.startswith(".") for part in parts):
            return None
        if name.endswith(".json") and parts[0] != _PACKAGES:  # settings of tools; the page itself has none
            return None
        if parts[0] == _PACKAGES and self.packages.isdisjoint(parts[1:2]):
            return None
        path = self.root.joinpath(*parts)
        try:
            is_there = path.suffix in MEDIA_TYPES and path.is_file() and path.resolve().is_relative_to(self.root)
        except OSError:  # no file system has names so long
            is_there = False
        return path if is_there else None
