"""`duospacenet demo`: export, check, run and evaluate the shipped weights on a synthetic scene."""

from pathlib import Path
from typing import Annotated

import typer

from .console import print_message, print_result, show_progress
from .evaluate import evaluate
from .export import export
from .options import OUTPUT
from .parity import parity

OutOption = Annotated[
    Path, typer.Option(help="Folder for the bundle and the results.", metavar="FOLDER", rich_help_panel=OUTPUT)
]


def demo(out: OutOption = Path("out/demo")) -> None:
    """Export the shipped weights, check their parity, run them on a synthetic scene, render pictures, and evaluate.

    The bundle of an earlier demo is checked again, or exported again if other weights are shipped now.

    \b
    Example:
      duospacenet demo --out out/demo
    """
    from ..jobs import demonstration
    from .run_table import print_run

    started = demonstration.prepare_demo(out, print_message)
    if started.exported:
        parity(started.bundle, weights=started.weights)
    else:
        export(out=started.bundle, preset=demonstration.PRESET, weights=started.weights)
    print_run(demonstration.run_demo(started, show_progress, print_message))
    evaluate([str(started.bundle), demonstration.SOURCE])
    text = f"one picture: {started.picture}; all pictures: {out / 'video.mp4'}"
    print_result(text, markup=False, soft_wrap=True)
