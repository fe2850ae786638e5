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

AnchorsOption = Annotated[
    Path | None,
    typer.Option(
        "--anchors",
        help="Initial queries: a file of `duospacenet anchors`, Sparse4D's nuscenes_kmeans900.npy, or a checkpoint of "
        "Sparse4D. By default they are clustered from the true boxes.",
        metavar="FILE",
        rich_help_panel=INPUT,
    ),
]
ValidationOption = Annotated[
    list[str] | None,
    typer.Option(
        "--validation",
        help="A held-out source to evaluate the model on during the training, as for --source. Repeatable. The weights "
        "with the best NDS, or the best mean IoU of the maps if there are no boxes, are kept in best.safetensors.",
        metavar="SOURCE",
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

TensorboardOption = Annotated[
    bool,
    typer.Option(
        "--tensorboard",
        help="Write TensorBoard logs to the folder tensorboard in --out (extra tensorboard).",
        rich_help_panel=OUTPUT,
    ),
]

# Behaviour

RecipeOption = Annotated[
    str,
    typer.Option(
        "--recipe",
        help="The settings of the training: cpu, paper, or your own .toml file. Options without a default have the "
        "recipe's value.",
        metavar="cpu|paper|FILE",
        rich_help_panel=BEHAVIOUR,
    ),
]
SetOption = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        help="Another value for any setting of the recipe, e.g. dropout=0.2. Repeatable.",
        metavar="NAME=VALUE",
        rich_help_panel=BEHAVIOUR,
    ),
]
TasksOption = Annotated[
    str | None,
    typer.Option("--tasks", help="The tasks to train.", metavar="both|detection|maps", rich_help_panel=BEHAVIOUR),
]
StepsOption = Annotated[
    int | None, typer.Option("--steps", help="Number of optimiser steps.", metavar="STEPS", rich_help_panel=BEHAVIOUR)
]
EpochsOption = Annotated[
    int | None,
    typer.Option(
        "--epochs", help="Passes over the sources, instead of --steps.", metavar="N", rich_help_panel=BEHAVIOUR
    ),
]
BatchSizeOption = Annotated[
    int | None,
    typer.Option(
        "--batch-size",
        help="Batch size: frames per step, in all processes together.",
        metavar="FRAMES",
        rich_help_panel=BEHAVIOUR,
    ),
]
FramesPerClipOption = Annotated[
    int | None,
    typer.Option(
        "--frames-per-clip",
        help="Consecutive frames of a scene, trained on one after the other.",
        metavar="FRAMES",
        rich_help_panel=BEHAVIOUR,
    ),
]
LearningRateOption = Annotated[
    float | None,
    typer.Option(
        "--learning-rate",
        help="Peak of the learning rate, which decreases along a cosine.",
        metavar="RATE",
        rich_help_panel=BEHAVIOUR,
    ),
]
WarmupStepsOption = Annotated[
    int | None,
    typer.Option(
        "--warmup-steps",
        help="Steps of linear learning-rate warm-up, 0 = off.",
        metavar="STEPS",
        rich_help_panel=BEHAVIOUR,
    ),
]
PretrainingOption = Annotated[
    bool | None,
    typer.Option(
        "--pretraining",
        help="Train only the image encoder, with a detection head on the PV features.",
        rich_help_panel=BEHAVIOUR,
    ),
]
ResumeOption = Annotated[
    bool,
    typer.Option(
        "--resume",
        help="Continue from the last checkpoint in --out, with the same settings. --steps or --epochs may be larger.",
        rich_help_panel=BEHAVIOUR,
    ),
]
ValidateEveryOption = Annotated[
    int | None,
    typer.Option(
        "--validate-every",
        help="Steps between two validations, 1000 by default. The last step is validated as well.",
        min=1,
        metavar="STEPS",
        rich_help_panel=BEHAVIOUR,
    ),
]
SeedOption = Annotated[
    int | None,
    typer.Option(
        "--seed",
        help="Seed of all random numbers: initial weights, order of the data, augmentation; 0 to 999.",
        metavar="N",
        rich_help_panel=BEHAVIOUR,
    ),
]
DeviceOption = Annotated[
    str,
    typer.Option(
        "--device",
        help="auto uses the GPU if there is one. Under torchrun, each process has its own GPU; with cuda:N, all use "
        "one.",
        metavar="auto|cpu|cuda|cuda:N",
        rich_help_panel=BEHAVIOUR,
    ),
]

# Advanced

BackboneLearningRateOption = Annotated[
    float | None,
    typer.Option(
        "--backbone-learning-rate",
        help="Peak learning rate of the backbone. By default it keeps the recipe's ratio to --learning-rate.",
        metavar="RATE",
        rich_help_panel=ADVANCED,
    ),
]
GridMaskOption = Annotated[
    float | None,
    typer.Option(
        "--grid-mask",
        help="Probability of GridMask augmentation, 0 to 1.",
        metavar="PROBABILITY",
        rich_help_panel=ADVANCED,
    ),
]
AuxiliaryMatchesOption = Annotated[
    int | None,
    typer.Option(
        "--auxiliary-matches",
        help="Queries matched to each object in all decoder layers but the last.",
        metavar="N",
        rich_help_panel=ADVANCED,
    ),
]
DenoisingOption = Annotated[
    int | None,
    typer.Option(
        "--denoising", help="Denoising query groups per frame, 0 = off.", metavar="GROUPS", rich_help_panel=ADVANCED
    ),
]
PvSupervisionOption = Annotated[
    bool | None,
    typer.Option(
        "--pv-supervision/--no-pv-supervision",
        help="Train an auxiliary detection head on the PV features.",
        rich_help_panel=ADVANCED,
    ),
]
BevSupervisionOption = Annotated[
    bool | None,
    typer.Option(
        "--bev-supervision/--no-bev-supervision",
        help="Train an auxiliary detection head on the BEV features.",
        rich_help_panel=ADVANCED,
    ),
]
AmpOption = Annotated[
    str | None,
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
        help="Processes that prepare the next clips, 0 = none. Under torchrun, for each of its processes.",
        min=0,
        metavar="N",
        rich_help_panel=ADVANCED,
    ),
]
AccumulationStepsOption = Annotated[
    int,
    typer.Option(
        "--accumulation-steps",
        help="Parts of a batch that are computed one after the other, to save memory.",
        min=1,
        metavar="N",
        rich_help_panel=ADVANCED,
    ),
]
ActivationCheckpointingOption = Annotated[
    bool,
    typer.Option(
        "--activation-checkpointing",
        help="Compute activations again in the backward pass: less memory, about a third more time.",
        rich_help_panel=ADVANCED,
    ),
]
