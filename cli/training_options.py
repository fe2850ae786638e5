"""The options of `duospacenet train`."""

from pathlib import Path
from typing import Annotated

import typer

from .options import ADVANCED, BEHAVIOUR, INPUT, OUTPUT

# Input

SourceOption = Annotated[
    list[str] | None,
    typer.Option(
        "--source",
        help="A source with ground truth: a scene folder, trusted:FOLDER, nuscenes:ROOT[@VERSION][/SPLIT] or "
        "synthetic:SEED[:FRAMES]. Repeatable. Default: an endless supply of new synthetic scenes.",
        metavar="SOURCE",
        rich_help_panel=INPUT,
    ),
]
InitialWeightsOption = Annotated[
    Path | None,
    typer.Option(
        "--weights",
        help="Checkpoint to start from, by default random initialisation. Without --preset and --config, its metadata "
        "must contain the configuration.",
        metavar="FILE",
        rich_help_panel=INPUT,
    ),
]

# Output

OutOption = Annotated[
    Path,
    typer.Option(
        "--out",
        help="Folder for the weights, the training state, the log and the loss curves.",
        metavar="FOLDER",
        show_default=False,
        rich_help_panel=OUTPUT,
    ),
]
SaveEveryOption = Annotated[
    int,
    typer.Option(
        "--save-every", help="Steps between two checkpoints, at least.", min=1, metavar="STEPS", rich_help_panel=OUTPUT
    ),
]

# Behaviour

StepsOption = Annotated[
    int, typer.Option("--steps", help="Number of optimiser steps.", metavar="STEPS", rich_help_panel=BEHAVIOUR)
]
BatchSizeOption = Annotated[
    int,
    typer.Option(
        "--batch-size",
        help="Batch size: frames per step, each from a different scene.",
        metavar="FRAMES",
        rich_help_panel=BEHAVIOUR,
    ),
]
FramesPerClipOption = Annotated[
    int,
    typer.Option(
        "--frames-per-clip",
        help="Consecutive frames of a scene, trained on one after the other.",
        metavar="FRAMES",
        rich_help_panel=BEHAVIOUR,
    ),
]
LearningRateOption = Annotated[
    float,
    typer.Option(
        "--learning-rate",
        help="Peak learning rate, after the warm-up; it falls to zero along a cosine.",
        metavar="RATE",
        rich_help_panel=BEHAVIOUR,
    ),
]
WarmupStepsOption = Annotated[
    int,
    typer.Option(
        "--warmup-steps",
        help="Steps of linear learning-rate warm-up, 0 = off.",
        metavar="STEPS",
        rich_help_panel=BEHAVIOUR,
    ),
]
PretrainingOption = Annotated[
    bool,
    typer.Option(
        "--pretraining",
        help="Only train the image encoder, with a detection head on the PV features: no queries, BEV or maps.",
        rich_help_panel=BEHAVIOUR,
    ),
]
ResumeOption = Annotated[
    bool,
    typer.Option("--resume", help="Continue from the last checkpoint in --out.", rich_help_panel=BEHAVIOUR),
]
SeedOption = Annotated[
    int,
    typer.Option(
        "--seed",
        help="Seed of everything random: initial weights, scenes, GridMask and denoising; 0 to 999.",
        metavar="N",
        rich_help_panel=BEHAVIOUR,
    ),
]
DeviceOption = Annotated[
    str,
    typer.Option(
        "--device", help="auto uses the GPU if there is one.", metavar="auto|cpu|cuda", rich_help_panel=BEHAVIOUR
    ),
]

# Advanced

BackboneLearningRateOption = Annotated[
    float | None,
    typer.Option(
        "--backbone-learning-rate",
        help="Peak learning rate of the backbone. Default: that of the other parts; use a tenth of it for a trained "
        "backbone.",
        metavar="RATE",
        rich_help_panel=ADVANCED,
    ),
]
GridMaskOption = Annotated[
    float,
    typer.Option(
        "--grid-mask",
        help="Probability of GridMask augmentation at the last step, 0 to 1; it rises linearly from 0.",
        metavar="PROBABILITY",
        rich_help_panel=ADVANCED,
    ),
]
AuxiliaryMatchesOption = Annotated[
    int,
    typer.Option(
        "--auxiliary-matches",
        help="Queries matched to each object in all decoder layers but the last.",
        metavar="N",
        rich_help_panel=ADVANCED,
    ),
]
DenoisingOption = Annotated[
    int,
    typer.Option(
        "--denoising", help="Denoising query groups per frame, 0 = off.", metavar="GROUPS", rich_help_panel=ADVANCED
    ),
]
PvSupervisionOption = Annotated[
    bool,
    typer.Option(
        "--pv-supervision/--no-pv-supervision",
        help="Train an auxiliary detection head on the PV features.",
        rich_help_panel=ADVANCED,
    ),
]
BevSupervisionOption = Annotated[
    bool,
    typer.Option(
        "--bev-supervision/--no-bev-supervision",
        help="Train an auxiliary detection head on the BEV features.",
        rich_help_panel=ADVANCED,
    ),
]
AmpOption = Annotated[
    str,
    typer.Option(
        "--amp",
        help="Automatic mixed precision: the type in which convolutions compute.",
        metavar="off|bfloat16|float16",
        rich_help_panel=ADVANCED,
    ),
]
WorkersOption = Annotated[
    int,
    typer.Option(
        "--workers",
        help="Processes that prepare the next clips, 0 = none.",
        min=0,
        metavar="N",
        rich_help_panel=ADVANCED,
    ),
]
