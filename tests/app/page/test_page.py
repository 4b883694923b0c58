"""The page is served from its folder, and nothing else is; the documentation needs no other host."""

import json
import re
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import urlsplit

import httpx
import pytest

from app.page.files import PageFiles
from app.settings import Settings
from interloc.osm.policies import POLICIES
from interloc.osm.untrusted import SIMULATOR
from tests.app.conftest import Serve
from tests.app.processes import raw_get

PAGE = """<!doctype html><title>InterLoc</title><script type="module" src="static/js/main.js"></script>"""


def write_page(folder: Path) -> Path:
    """Write a page that needs one package, among things that are nobody's business."""
    root = folder / "static"
    for name, content in {
        "index.html": PAGE,
        "package.json": json.dumps({"dependencies": {"leaflet": "1.9.4"}, "devDependencies": {"tool": "1"}}),
        "js/main.js": "export const answer = 42;\n" * 200,
        "js/upload/main.js": "export const other = 43;\n" * 200,
        "css/style.css": "body { margin: 0 }",
        "tsconfig.json": '"secret"',
        "icon.svg": "<svg xmlns='http://www.w3.org/2000/svg'/>",
        "notes.py": "secret",
        ".env": "secret",
        "js/.hidden.js": "secret",
        "node_modules/leaflet/dist/leaflet.js": "L = 1",
        "node_modules/tool/dist/tool.js": "secret",
        "node_modules/.package-lock.json": "secret",
    }.items():
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_text(content)
    (folder / "outside.js").write_text("secret")
    (root / "js/link.js").symlink_to(folder / "outside.js")
    return root


@pytest.fixture
def static(tmp_path: Path) -> Path:
    """Files of a page, to be changed."""
    return write_page(tmp_path)


@pytest.fixture(scope="module")
def page_files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The files of the page that the tests of this module look at."""
    return write_page(tmp_path_factory.mktemp("page"))


@pytest.fixture(scope="module")
def page(serve_all: Serve, page_files: Path) -> httpx.Client:
    return serve_all(static_dir=page_files)


def test_the_page_and_its_files(page: httpx.Client, page_files: Path) -> None:
    for address, name, media_type in (
        ("/static/js/main.js", "js/main.js", "text/javascript; charset=utf-8"),
        ("/static/js/upload/main.js", "js/upload/main.js", "text/javascript; charset=utf-8"),
        ("/static/css/style.css", "css/style.css", "text/css; charset=utf-8"),
        ("/static/icon.svg", "icon.svg", "image/svg+xml"),
        ("/static/node_modules/leaflet/dist/leaflet.js", "node_modules/leaflet/dist/leaflet.js", None),
    ):
        answer = page.get(address)
        assert answer.status_code == 200
        assert answer.content == (page_files / name).read_bytes()
        assert media_type in {None, answer.headers["content-type"]}
        assert answer.headers["cache-control"] == "no-cache"
        assert "'unsafe-inline'" not in answer.headers["content-security-policy"]
        assert page.get(address, headers={"if-none-match": answer.headers["etag"]}).status_code == 304
        assert page.head(address).headers["etag"] == answer.headers["etag"]


def test_the_bundle_is_the_page_as_long_as_it_is_made_of_these_modules(static: Path) -> None:
    source = (static / "js/main.js").read_text()
    (static / "bundle").mkdir()
    (static / "bundle/main.js").write_text("export const answer=42")
    of_map = {"sources": ["../js/main.js", "../node_modules/gone.js"], "sourcesContent": [source, "of a package"]}
    (static / "bundle/main.js.map").write_text(json.dumps(of_map))
    files = PageFiles(Settings(static_dir=static))
    assert b"/bundle/main.js" in files.index()
    (static / "js/main.js").write_text(source.replace("42", "43"))
    assert b"/js/main.js" in files.index()
    (static / "bundle/main.js.map").write_text("no map")
    assert b"/js/main.js" in files.index()


def test_browsers_keep_the_files_of_one_version_of_the_page(page: httpx.Client, page_files: Path) -> None:
    answer = page.get("/")
    (script,) = re.findall(r'src="(static/@\w+/js/main\.js)"', answer.text)
    assert answer.text.replace(script, "static/js/main.js") == PAGE
    assert (answer.headers["cache-control"], answer.headers["content-type"]) == ("no-cache", "text/html; charset=utf-8")
    assert "'unsafe-inline'" not in answer.headers["content-security-policy"]
    assert page.get("/", headers={"if-none-match": answer.headers["etag"]}).status_code == 304
    assert page.head("/").headers["etag"] == answer.headers["etag"]
    kept = page.get(script)
    assert kept.content == (page_files / "js/main.js").read_bytes()
    assert kept.headers["cache-control"] == "public, max-age=31536000, immutable"
    (page_files / "css/style.css").write_text("body { color: red }")
    # That version is gone: this one must not be kept in its place.
    assert page.get(script).headers["cache-control"] == "no-cache"
    assert script not in page.get("/").text
    for wrong in ("/static/@", "/static/@1234", "/static/@1234/", "/static/@1/@2/js/main.js", "/static/@1/../main.py"):
        assert raw_get(page, wrong)[0] == 404


HIDDEN = ["package.json", "tsconfig.json", "notes.py", ".env", "js/.hidden.js", "js/link.js", "js", "", "js//main.js"]
HIDDEN += ["../outside.js", "js/../../outside.js", "%2e%2e/outside.js", "..%2foutside.js", "/etc/passwd"]
HIDDEN += ["js/main.js%00.js", *(f"node_modules{end}" for end in ("", "/tool/dist/tool.js", "/.package-lock.json"))]


@pytest.mark.parametrize("name", [*HIDDEN, f"{'a' * 300}.js"])
def test_nothing_else_is_served(name: str, page: httpx.Client) -> None:
    status, content = raw_get(page, f"/static/{name}")
    assert status == 404
    assert b"secret" not in content
    assert json.loads(content)["title"]


def test_without_the_page_the_documentation_is_there(serve: Serve, tmp_path: Path) -> None:
    client = serve(static_dir=tmp_path / "nothing", root_path="/interloc")
    answer = client.get("/")
    assert (answer.status_code, answer.headers["location"]) == (307, "/interloc/docs")
    answer = client.get("/docs")
    assert (answer.status_code, answer.headers["location"]) == (307, "/interloc/openapi.json")


def test_a_page_without_its_packages_is_not_installed(serve: Serve, static: Path) -> None:
    (static / "node_modules/leaflet").rename(static / "node_modules/gone")
    client = serve(static_dir=static)
    assert client.get("/").status_code == 307
    (static / "node_modules/gone").rename(static / "node_modules/leaflet")
    assert "/js/main.js" in client.get("/").text, "found without a restart"


class _Addresses(HTMLParser):
    """Gathers what a page loads."""

    def __init__(self) -> None:
        super().__init__()
        self.found: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        names = {"script": "src", "link": "href", "img": "src"}
        self.found += [value for name, value in attrs if name == names.get(tag) and value]


def test_the_real_page_and_documentation_load_from_here_only(client: httpx.Client) -> None:
    if client.get("/").status_code != 200:
        pytest.skip("the page is not installed: `npm ci` in static/")
    for address in ("/", "/docs"):
        answer = client.get(address)
        page = _Addresses()
        page.feed(answer.text)
        assert page.found
        for each in page.found:
            assert not urlsplit(each).netloc
            assert client.get(each).status_code == 200, each
    assert "'unsafe-eval'" not in answer.headers["content-security-policy"]
    assert "script-src 'self';" in answer.headers["content-security-policy"]


def test_what_the_page_needs_to_know(serve: Serve) -> None:
    told = serve(tile_url="", trash_h=5, overpass_url="").get("/config.json").json()
    assert told["tile_url"] is None
    assert told["overpass"] is False
    assert told["needs_token"] is False
    assert told["trash_h"] == 5
    assert told["version"]


def test_the_page_learns_the_words_for_what_it_shows(serve_all: Serve) -> None:
    told = serve_all().get("/config.json").json()
    assert [each["name"] for each in told["policies"]] == list(POLICIES)
    assert all(each["description"].endswith(".") for each in [*told["policies"], *told["layers"]])
    assert {each["name"] for each in told["layers"] if each["is_osm"]} == {
        "osm_nodes",
        "matches",
        "osm_roads",
        "osm_buildings",
        "places",
    }
    schemes = {each["name"]: each for each in told["label_schemes"]}
    assert schemes["semantickitti"]["road"] == [40, 60]
    assert ".osm.pbf" in told["file_kinds"]["maps"]
    assert ".tar.zst" in told["file_kinds"]["archives"]
    assert told["simulator"] == SIMULATOR
    assert "service" in told["drivable"]
    assert told["search_radius_km"] == {"default": 3.0, "minimum": 0.1, "maximum": 20.0}
    assert told["max_compared_jobs"] == 8


def test_the_page_is_open_to_all_and_says_that_a_token_is_needed(serve: Serve, static: Path) -> None:
    client = serve(static_dir=static, token="a-token-that-nobody-guesses")  # noqa: S106
    assert client.get("/config.json").json()["needs_token"] is True
    assert client.get("/").status_code == client.get("/static/js/main.js").status_code == 200
    assert client.get("/api/v1/models").status_code == 401
