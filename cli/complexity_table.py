"""The complexity of a model as a table, or as one JSON object."""

from typing import TYPE_CHECKING

from rich.table import Table

from ..runtime.errors import UsageError
from ..runtime.extras import needs_extra
from .console import print_json, print_result

if TYPE_CHECKING:
    from ..model import DuoSpaceNetConfig
    from ..model.complexity import Complexity

RULE = (
    "FLOPs: two for each multiply-add of convolutions, linear layers and matrix products. With sampling: deformable "
    "kernels too, and four multiply-adds for each number that is sampled bilinearly."
)


def show_complexity(config: "DuoSpaceNetConfig", num_frames: int, as_json: bool) -> None:
    """Count a model's parameters and operations, and print them by part.

    Raises UsageError for more frames than the model's window has.
    """
    if num_frames > config.num_frames:
        raise UsageError(
            f"--frames: expected at most {config.num_frames}, the window of {config.preset}; got {num_frames}."
        )
    with needs_extra("export"):
        from ..model.complexity import measure
    parts = measure(config, num_frames)
    if as_json:
        counted = {name: part._asdict() for name, part in parts.items()}
        print_json({"preset": config.preset, "frames": num_frames, "parts": counted})
    else:
        print_result(_table(config.preset, num_frames, parts))
        print_result(RULE)


def _table(preset: str, num_frames: int, parts: dict[str, "Complexity"]) -> Table:
    title = f"{preset}, a window of {num_frames} {'frame' if num_frames == 1 else 'frames, each encoded'}"
    table = Table(title=title, title_justify="left")
    for column in ("part", "parameters, M", "GFLOPs", "with sampling"):
        table.add_column(column, justify="left" if column == "part" else "right")
    for name, part in parts.items():
        if name == "total":
            table.add_section()
        flops = (_digits(number / 1e9) for number in (part.flops, part.flops_with_sampling))
        millions = part.parameters / 1e6
        table.add_row(name, f"{millions:.2f}" if millions >= 0.01 else f"{millions:.2g}", *flops)
    return table


def _digits(number: float) -> str:
    """One decimal, or two digits of what is less than one."""
    return f"{number:.1f}" if number >= 1 else f"{number:.2g}"
