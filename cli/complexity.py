"""The complexity of a model as a table, or as one JSON object."""

from typing import TYPE_CHECKING

from rich.table import Table

from .console import needs_extra, print_json, results

if TYPE_CHECKING:
    from ..model import DuoSpaceNetConfig
    from ..model.complexity import Complexity

RULE = (
    "FLOPs: two for each multiply-add of convolutions, linear layers and matrix products. With sampling: deformable "
    "kernels too, and four multiply-adds for each number that is sampled bilinearly."
)


def show_complexity(config: "DuoSpaceNetConfig", num_frames: int, as_json: bool) -> None:
    """Count a model's parameters and operations, and print them by part."""
    with needs_extra("export"):
        from ..model.complexity import measure
    parts = measure(config, num_frames)
    if as_json:
        counted = {name: part._asdict() for name, part in parts.items()}
        print_json({"preset": config.preset, "frames": num_frames, "parts": counted})
    else:
        results.print(_table(config.preset, num_frames, parts))
        results.print(RULE)


def _table(preset: str, num_frames: int, parts: dict[str, "Complexity"]) -> Table:
    title = f"{preset}, a window of {num_frames} {'frame' if num_frames == 1 else 'frames, each encoded'}"
    table = Table(title=title, title_justify="left")
    for column in ("part", "parameters, M", "GFLOPs", "with sampling"):
        table.add_column(column, justify="left" if column == "part" else "right")
    for name, part in parts.items():
        if name == "total":
            table.add_section()
        flops = (f"{number / 1e9:.1f}" for number in (part.flops, part.flops_with_sampling))
        table.add_row(name, f"{part.parameters / 1e6:.2f}", *flops)
    return table
