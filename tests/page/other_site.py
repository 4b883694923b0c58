"""A web page of another origin than the service, with MapLibre GL and pmtiles.js of the npm packages."""

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer

from tests.page.browsers import LEAFLET

PACKAGES = LEAFLET.parent

_PAGE = """<!doctype html><html lang="en"><link rel="icon" href="data:,">
<link rel="stylesheet" href="/maplibre-gl/dist/maplibre-gl.css"><style>#map { width: 700px; height: 500px }</style>
<div id="map"></div><script src="/pmtiles/dist/pmtiles.js"></script>
<script type="module">
import * as maplibregl from "/maplibre-gl/dist/maplibre-gl.mjs";
maplibregl.addProtocol("pmtiles", new pmtiles.Protocol({ metadata: true }).tile);
window.show = (center, sources, layers) => new Promise((done, fail) => {
  const map = new maplibregl.Map({ container: "map", center, zoom: 16, style: { version: 8, sources, layers } });
  map.on("error", ({ error }) => fail(error));
  map.once("idle", () => done((window.map = map) && null));
});
window.ids = (source, layer) =>
  [...new Set(map.querySourceFeatures(source, { sourceLayer: layer }).map((each) => each.properties.id))].sort();
window.drawn = (layer) =>
  [...new Set(map.queryRenderedFeatures({ layers: [layer] }).map((each) => each.properties.id))].sort();
</script>"""


class _Site(SimpleHTTPRequestHandler):
    """The page, and the files of the packages."""

    extensions_map = {**SimpleHTTPRequestHandler.extensions_map, ".mjs": "text/javascript"}  # noqa: RUF012

    def do_GET(self) -> None:
        if self.path != "/":
            return super().do_GET()
        self.send_response(200)
        self.send_header("Content-Type", "text/html; charset=utf-8")
        self.end_headers()
        self.wfile.write(_PAGE.encode())
        return None

    def log_message(self, *_: object) -> None:
        """Say nothing."""


@contextmanager
def served() -> Iterator[str]:
    """Serve it; yields its origin."""
    server = ThreadingHTTPServer(("127.0.0.1", 0), partial(_Site, directory=str(PACKAGES)))
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    try:
        yield f"http://127.0.0.1:{server.server_port}"
    finally:
        server.shutdown()
        server.server_close()
        thread.join()
