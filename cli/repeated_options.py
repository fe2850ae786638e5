"""Options that are given more than once: refused, if only the last value would be used."""

from collections import Counter
from typing import Any

from typer.core import TyperOption


def check_repeated_options(command: Any, ctx: Any, args: list[str]) -> None:
    """Check that every option with a single value is given at most once.

    command: the typer command that gets the arguments `args`.

    Options with a list of values may be repeated. So may flags without a `--no-` form, because nothing is lost then.
    Raises typer's usage error.
    """
    if ctx.resilient_parsing:  # shell completion
        return
    _, _, given = command.make_parser(ctx).parse_args(args=list(args))
    for parameter, number in Counter(given).items():
        if number > 1 and _keeps_last_only(parameter):
            names = "/".join((*parameter.opts, *parameter.secondary_opts))
            ctx.fail(f"{names}: expected at most once; got it {number} times. Leave out all but one")


def _keeps_last_only(parameter: Any) -> bool:
    if not isinstance(parameter, TyperOption) or parameter.multiple or parameter.count:
        return False
    return not parameter.is_flag or bool(parameter.secondary_opts)
