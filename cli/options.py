"""Options that several commands share."""

from pathlib import Path
from typing import Annotated

import typer

WeightsOption = Annotated[
    Path | None,
    typer.Option(
        "--weights",
        help="Checkpoint, .safetensors or weights-only .pth: our own layout, torchvision's of a ResNet, detectron2's "
        "of a VoVNet, or mmdetection3d's of an image backbone and neck.",
    ),
]
RandomOption = Annotated[bool, typer.Option("--random-weights", help="Draw the weights at random, from --seed.")]
SeedOption = Annotated[int, typer.Option(help="Seed of what is drawn at random.", min=0)]
AllowMissingOption = Annotated[
    list[str] | None,
    typer.Option(
        metavar="PATTERN",
        help="Tensors, by our names (`decoder.*`), that the checkpoint need not have; they are drawn from --seed. "
        "May be given again.",
    ),
]
AnchorsOption = Annotated[
    Path | None,
    typer.Option(
        "--anchors",
        help="Where the queries start, from `duospacenet anchors`; for weights without poses of their own.",
    ),
]
