"""The complexity of a model as a table, or as one JSON object."""

from typing import TYPE_CHECKING

from rich.table import Table

from .console import print_json, print_result

if TYPE_CHECKING:
    from ..model import DuoSpaceNetConfig
    from ..model.complexity import Complexity

_COUNTING_RULE = (
    "FLOPs: two per multiply-add of convolutions, linear layers and matrix products. With sampling: deformable "
    "convolutions too, and four multiply-adds per bilinearly sampled value."
)


def print_complexity(config: "DuoSpaceNetConfig", num_frames: int, as_json: bool) -> None:
    """Count a model's parameters and FLOPs, and print them by part.

    Raises UsageError for more frames than the model's temporal window has.
    """
    from ..jobs.inspection import measure_complexity

    parts = measure_complexity(config, num_frames)
    if as_json:
        counts = {name: part._asdict() for name, part in parts.items()}
        print_json({"preset": config.preset, "frames": num_frames, "parts": counts})
    else:
        print_result(_table(config.preset, num_frames, parts))
        print_result(_COUNTING_RULE)


def _table(preset: str, num_frames: int, parts: dict[str, "Complexity"]) -> Table:
    frames = "one frame" if num_frames == 1 else f"{num_frames} frames, each of them encoded"
    table = Table(title=f"{preset}, temporal window of {frames}", title_justify="left")
    for column in ("part", "parameters, M", "GFLOPs", "with sampling"):
        table.add_column(column, justify="left" if column == "part" else "right")
    for name, part in parts.items():
        if name == "total":
            table.add_section()
        flops = (_format(number / 1e9) for number in (part.flops, part.flops_with_sampling))
        millions = part.parameters / 1e6
        table.add_row(name, f"{millions:.2f}" if millions >= 0.01 else f"{millions:.2g}", *flops)
    return table


def _format(number: float) -> str:
    """One decimal; two significant digits below one."""
    return f"{number:.1f}" if number >= 1 else f"{number:.2g}"
