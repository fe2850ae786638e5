"""`duospacenet demo`: the main job from end to end, with the trained weights that ship, on a drawn drive."""

import shutil
from pathlib import Path
from typing import Annotated

import typer

from ..jobs.output_folder import Job, check_run_folder, read_job, run_folder
from ..jobs.pictures import Pictures
from ..jobs.sources import open_source
from ..runtime import Pipeline
from ..runtime.bundle.manifest import read_manifest, sha256
from ..weights import shipped_weights
from .console import print_message
from .evaluate import evaluate_bundle
from .export import export
from .parity import parity
from .run import run_source

PRESET = "nano"
SOURCE = "synthetic:7:16"  # of the seeds that no training sees
PICTURE = 12  # the frame whose picture is named at the end


def demo(
    out: Annotated[Path, typer.Option(help="Folder for the bundle and the results.")] = Path("out/demo"),
) -> None:
    """Export the trained weights that ship, prove them, run them on a drawn drive that they never saw, draw what they
    find, and say how good it is.

    A bundle that an earlier demo left is proven again, or made again where other weights ship by now.
    """
    job: Job = {"demo": SOURCE}
    is_ours = read_job(out) == job
    check_run_folder(out, overwrite=is_ours, resume=False)
    bundle, weights = out / "bundle", shipped_weights(PRESET)
    if is_ours and bundle.exists() and read_manifest(bundle).weights.file_sha256 != sha256(weights):
        print_message(f"{bundle}: an earlier demo made it from other weights; it is made again")
        shutil.rmtree(bundle)
    if bundle.exists():
        parity(bundle, weights=weights)
    else:
        export(preset=PRESET, out=bundle, weights=weights)
    with run_folder(out, job, resume=False):
        pipeline = Pipeline.load(bundle)
        drive = open_source(SOURCE)
        run_source(
            pipeline, pipeline.stream(maps=True), drive, out, ("jsonl",), Pictures(draw=True, video=True)
        ).print()
    evaluate_bundle(bundle, [SOURCE])
    typer.echo(f"a picture: {out / 'pictures' / f'{PICTURE:06d}.png'}; all of them: {out / 'video.mp4'}")
