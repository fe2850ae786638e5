"""`duospacenet config`: model configurations as text."""

import sys
from typing import Annotated, Literal

import typer

from .options import INPUT, OUTPUT
from .plain_help import PlainHelpCommand, PlainHelpGroup

app = typer.Typer(cls=PlainHelpGroup, add_completion=False, rich_markup_mode=None, pretty_exceptions_enable=False)


@app.callback()
def config() -> None:
    """Print model configurations, to start your own from."""


@app.command(cls=PlainHelpCommand)
def show(
    preset: Annotated[
        str, typer.Argument(metavar="PRESET", help="Name of a preset, such as small or tiny-pv.", rich_help_panel=INPUT)
    ],
    format: Annotated[
        Literal["toml", "json"], typer.Option(help="Format of the configuration.", rich_help_panel=OUTPUT)
    ] = "toml",
) -> None:
    """Print the configuration of a preset. Save it, edit it, and pass it as --config.

    The field `preset` is a free name for your configuration. A file with an unknown field or a value that is not
    allowed is refused with exit code 3.

    \b
    Example:
      duospacenet config show small > mine.toml
    """
    from ..jobs.config_file import config_to_json, config_to_toml
    from ..jobs.models import find_preset

    to_text = config_to_toml if format == "toml" else config_to_json
    sys.stdout.write(to_text(find_preset(preset)))
