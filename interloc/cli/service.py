"""What the commands of the service share: its settings, and a word where it is not installed."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from interloc.errors import ConfigError, InterLocError

if TYPE_CHECKING:
    from app.settings import Settings

DATA_DIR = click.option(
    "--data-dir", type=click.Path(path_type=Path), help="Folder of drives and results.  [default: ./interloc-data]"
)


def read_settings(given: dict[str, Any]) -> Settings:
    """Read the environment, and let the options that were given prevail.

    Raises
    ------
    InterLocError
        The service is not installed.
    ConfigError
        A setting has no meaning.
    """
    try:
        from app.settings import Settings
    except ModuleNotFoundError as error:
        raise InterLocError(
            f"the service needs {error.name}, which is not installed: pip install 'interloc[service]'"
        ) from error
    from pydantic import ValidationError

    try:
        return Settings(**{name: value for name, value in given.items() if value is not None})
    except ValidationError as error:
        first = error.errors(include_input=False)[0]
        name = "_".join(str(part) for part in first["loc"])
        raise ConfigError(f"INTERLOC_{name.upper()} or --{name.replace('_', '-')}: {first['msg']}") from error
