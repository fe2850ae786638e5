"""`duospacenet demo`: the main job from end to end, on a drawn drive."""

from pathlib import Path
from typing import Annotated

import typer

from ..runtime import Pipeline
from ..runtime.sources import open_source
from .album import Pictures
from .export import export
from .folder import Job, check_run_folder, read_job, run_folder
from .parity import parity
from .run import run_source

PRESET = "nano"
SOURCE = "synthetic:7:8"


def demo(
    out: Annotated[Path, typer.Option(help="Folder for the bundle and the results.")] = Path("out/demo"),
) -> None:
    """Export a model, prove it, run it on a drawn drive and draw what the drive holds.

    The weights are drawn at random, so the model's own boxes mean nothing and the pictures show the drive's truth.
    A bundle that an earlier demo left is proven again.
    """
    job: Job = {"demo": SOURCE}
    check_run_folder(out, overwrite=read_job(out) == job, resume=False)
    bundle = out / "bundle"
    if bundle.exists():
        parity(bundle, random_weights=True)
    else:
        export(preset=PRESET, out=bundle, random_weights=True)
    pictures = Pictures(draw=True, video=True, truth=True, min_score=None)
    with run_folder(out, job, resume=False):
        pipeline = Pipeline.load(bundle)
        run_source(pipeline, pipeline.stream(), open_source(SOURCE), out, ("jsonl",), pictures).print()
    typer.echo(f"pictures of the drive and its true boxes: {out / 'pictures'} and {out / 'video.mp4'}")
