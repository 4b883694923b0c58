"""Settings: the table of docs/service.md is true, and the environment is read."""

from pathlib import Path
from typing import Any

import pytest

from app.settings import GB, MB, Settings

SERVICE = Path(__file__).parents[2] / "docs" / "service.md"


def shown(name: str, value: Any) -> str:
    """A default as people read it."""
    if value is None or value == "":
        return ""
    if isinstance(value, bool):
        return "yes" if value else "no"
    if name.endswith("_bytes"):
        return f"{value // GB} GB" if value % GB == 0 else f"{value // MB} MB"
    return f"`{value:g}`" if isinstance(value, float) else f"`{value}`"


def settings_table() -> str:
    """The table of all settings, for docs/service.md."""
    lines = ["| `INTERLOC_` | default | what |", "|---|---|---|"]
    for name, field in Settings.model_fields.items():
        assert field.description, f"{name} is not described"
        lines.append(f"| `{name.upper()}` | {shown(name, field.default)} | {field.description} |")
    return "\n".join(lines)


def test_the_documentation_lists_all_settings() -> None:
    assert settings_table() in SERVICE.read_text(), f"docs/service.md must hold\n{settings_table()}"


def test_settings_come_from_the_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("INTERLOC_DATA_DIR", "/srv/interloc")
    monkeypatch.setenv("INTERLOC_TOKEN", "sixteen-letters-or-more")
    monkeypatch.setenv("INTERLOC_ROOT_PATH", "/interloc/")
    settings = Settings()
    assert settings.data_dir == Path("/srv/interloc")
    assert settings.sqlalchemy_url == "sqlite:////srv/interloc/interloc.sqlite3"
    assert settings.root_path == "/interloc"
    assert "sixteen" not in repr(settings)


@pytest.mark.parametrize(
    ("host", "loopback"),
    [("127.0.0.1", True), ("127.9.9.9", True), ("::1", True), ("localhost", True), ("10.0.0.1", False), ("::", False)],
)
def test_which_addresses_are_of_this_machine_only(host: str, loopback: bool) -> None:
    assert Settings(host=host).is_loopback is loopback
    assert not Settings(host="box.example").is_loopback
