"""`interloc completion`."""

from __future__ import annotations

import click
from click.shell_completion import get_completion_class

SHELLS = ("bash", "zsh", "fish")


@click.command(short_help="Completion of commands and options for your shell.")
@click.argument("shell", type=click.Choice(SHELLS))
@click.pass_context
def command(ctx: click.Context, shell: str) -> None:
    """Print the script by which SHELL completes commands and options of interloc.

    \b
    Examples:
      eval "$(interloc completion bash)"                                   in ~/.bashrc
      eval "$(interloc completion zsh)"                                    in ~/.zshrc
      interloc completion fish > ~/.config/fish/completions/interloc.fish
    """
    completion = get_completion_class(shell)
    if completion is None:
        raise click.UsageError(f"No completion for {shell}.")
    click.echo(completion(ctx.find_root().command, {}, "interloc", "_INTERLOC_COMPLETE").source())
