"""`interloc config`."""

import click

from interloc.cli import options


@click.command()
@options.config_options
@click.option("--schema", is_flag=True, help="Print what each setting means and allows (JSON Schema) instead.")
def command(preset: str, settings: tuple[str, ...], schema: bool) -> None:
    """Print the settings of a preset as JSON.

    \b
    Example:
      interloc config --preset paper
    """
    import json

    from interloc.config import DetectorConfig

    if schema:
        click.echo(json.dumps(DetectorConfig.model_json_schema(), indent=2))
    else:
        click.echo(options.configure(preset, settings).model_dump_json(indent=2))
