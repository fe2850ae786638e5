"""The commands' class: their help is plain text with the options grouped in panels, and no option is given twice.

typer's own panels need rich's Markdown reader. Its import takes longer than everything else that `--help` does.
"""

from typing import Any

from typer.core import TyperCommand, TyperGroup

from .options import ADVANCED, BEHAVIOUR, INPUT, OUTPUT
from .repeated_options import check_repeated_options

PANELS = ("Arguments", INPUT, OUTPUT, BEHAVIOUR, ADVANCED, "Options")


class PlainHelpCommand(TyperCommand):
    """A command with one help section per panel. Parameters without a `rich_help_panel` are Arguments or Options.

    An option with a single value is refused if it is given twice.
    """

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        check_repeated_options(self, ctx, args)
        return super().parse_args(ctx, args)

    def format_options(self, ctx: Any, formatter: Any) -> None:
        panels: dict[str, list[tuple[str, str]]] = {name: [] for name in PANELS}
        for parameter in self.get_params(ctx):
            record = parameter.get_help_record(ctx)
            if record is not None:
                panels[_panel_of(parameter)].append(record)
        for name, records in panels.items():
            if records:
                with formatter.section(name):
                    formatter.write_dl(records)


class PlainHelpGroup(TyperGroup):
    """A command with subcommands. The help of a subcommand does not import pydantic."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        # typer 0.29 converts the value None of a flag by pydantic, whose import takes twice as long as the help.
        # The flags of --help and of shell completion have that default; for them it means the same as False.
        for parameter in self.get_params(ctx):
            if getattr(parameter, "is_flag", False) and parameter.default is None:
                parameter.default = False
        return super().parse_args(ctx, args)


def _panel_of(parameter: Any) -> str:
    default = "Arguments" if parameter.param_type_name == "argument" else "Options"
    return getattr(parameter, "rich_help_panel", None) or default
