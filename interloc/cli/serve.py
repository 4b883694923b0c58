"""`interloc serve`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from interloc.cli import service


@click.command(short_help="Run the web service and its page.")
@click.option("--host", help="Address to listen on.  [default: 127.0.0.1]")
@click.option("--port", type=click.IntRange(0, 65535), help="0: any free one.  [default: 8000]")
@service.DATA_DIR
@click.option("--workers", type=click.IntRange(1, 256), help="Worker processes.  [default: one a core]")
@click.option("--dask", metavar="ADDRESS", help="Dask scheduler that does the work instead, as tcp://host:8786.")
@click.option("--allow-anonymous", is_flag=True, default=None, help="Serve other machines without any token.")
@click.option("--root-path", metavar="PATH", help="Path under which a reverse proxy shows the service.")
@click.option("--log-format", type=click.Choice(["json", "text"]), help="Of the log on stderr.  [default: json]")
@click.option("--log-level", type=click.Choice(["debug", "info", "warning", "error"]), help="[default: info]")
def command(**given: Any) -> None:
    """Run the web service: upload drives, run jobs, see the results on a map.

    Every option is a setting INTERLOC_<NAME> of the environment too; the README lists them all.

    \b
    Examples:
      interloc serve                                        for this machine only
      interloc token add alice && interloc serve --host 0.0.0.0
    """
    settings = service.read_settings(given)
    from app.server import serve
    from interloc.pipeline import versions

    def say_address(port: int) -> None:
        host = f"[{settings.host}]" if ":" in settings.host else settings.host
        address = f"http://{host}:{port}{settings.root_path}/"
        folder = Path(settings.data_dir).absolute()
        click.echo(f"InterLoc {versions()['interloc']} at {address} (data in {folder}); Ctrl-C stops it")

    serve(settings, say_address)
