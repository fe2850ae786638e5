"""Options that several commands share, and the panels that group options in the help."""

from pathlib import Path
from typing import Annotated

import typer

INPUT = "Input"
OUTPUT = "Output"
BEHAVIOUR = "Behaviour"
ADVANCED = "Advanced"

PresetOption = Annotated[
    str | None,
    typer.Option(
        "--preset",
        metavar="NAME",
        help="Model configuration by name: tiny, nano, small, base or large; or an ablation such as small-pv.",
        rich_help_panel=INPUT,
    ),
]
ConfigOption = Annotated[
    Path | None,
    typer.Option(
        "--config",
        metavar="FILE",
        help="Model configuration from a .toml or .json file, instead of --preset. "
        "`duospacenet config show small` prints one to start from.",
        rich_help_panel=INPUT,
    ),
]
WeightsOption = Annotated[
    Path | None,
    typer.Option(
        "--weights",
        metavar="FILE",
        help="Checkpoint: .safetensors, weights-only .pth, an index of shards, or a folder with one of these. "
        "Tensor names: this toolkit's, torchvision's ResNet, detectron2's VoVNet, or mmdetection3d's image backbone "
        "and neck.",
        rich_help_panel=INPUT,
    ),
]
RandomOption = Annotated[
    bool,
    typer.Option("--random-weights", help="Random weights from --seed instead of --weights.", rich_help_panel=INPUT),
]
SeedOption = Annotated[
    int, typer.Option("--seed", help="Seed of the random weights.", metavar="N", min=0, rich_help_panel=INPUT)
]
AllowMissingOption = Annotated[
    list[str] | None,
    typer.Option(
        "--allow-missing",
        metavar="PATTERN",
        help="Tensors that the checkpoint may lack, by this toolkit's names, e.g. `decoder.*`. They are initialised "
        "at random from --seed. If they include the whole neck, a neck that does not fit is left aside. Repeatable.",
        rich_help_panel=INPUT,
    ),
]
IgnoreOption = Annotated[
    list[str] | None,
    typer.Option(
        "--ignore",
        metavar="PATTERN",
        help="Tensors of the checkpoint to leave out, by their names in the file, e.g. `img_neck.*`. The manifest "
        "records them. Repeatable.",
        rich_help_panel=INPUT,
    ),
]
WeightsKeyOption = Annotated[
    str | None,
    typer.Option(
        "--weights-key",
        metavar="KEY",
        help="Key of the weights in the checkpoint, e.g. `model` or `ema.shadow`, if it holds several copies.",
        rich_help_panel=INPUT,
    ),
]
AnchorsOption = Annotated[
    Path | None,
    typer.Option(
        "--anchors",
        metavar="FILE",
        help="Initial query positions from `duospacenet anchors`, for weights without queries.pose.",
        rich_help_panel=INPUT,
    ),
]
ThreadsOption = Annotated[
    int | None,
    typer.Option(
        "--threads",
        help="Threads of the engine. Default: one per core that is available to this process.",
        metavar="N",
        min=1,
        rich_help_panel=ADVANCED,
    ),
]
EngineOption = Annotated[
    str,
    typer.Option(
        "--engine",
        help="Library that runs the graphs. openvino needs the extra openvino. Deformable convolutions then need "
        "export --dcn grid-sample.",
        metavar="onnxruntime|openvino",
        rich_help_panel=BEHAVIOUR,
    ),
]
EnginePrecisionOption = Annotated[
    str,
    typer.Option(
        "--engine-precision",
        help="float32, or default for the engine's own choice on this CPU. OpenVINO may choose bfloat16, which is "
        "faster and less accurate.",
        metavar="float32|default",
        rich_help_panel=ADVANCED,
    ),
]
HistoryStepOption = Annotated[
    float | None,
    typer.Option(
        "--history-step",
        help="Seconds between two frames of the temporal window, for streams that are faster than the training data: "
        "0.5 for nuScenes weights on a stream at 10 Hz. Default: the newest frames.",
        metavar="SECONDS",
        rich_help_panel=BEHAVIOUR,
    ),
]
LimitOption = Annotated[
    int | None,
    typer.Option(help="Only use the first N frames of each source.", metavar="N", min=1, rich_help_panel=BEHAVIOUR),
]
FastDecodingOption = Annotated[
    bool,
    typer.Option(
        "--fast-decoding",
        help="Decode JPEG files at a half or a quarter of their size where the network needs no more. Results change "
        "slightly.",
        rich_help_panel=ADVANCED,
    ),
]
NoCheckOption = Annotated[
    bool,
    typer.Option(
        "--no-check",
        help="Accept calibrations that check-rig calls broken, with a warning.",
        rich_help_panel=ADVANCED,
    ),
]
JsonOption = Annotated[
    bool,
    typer.Option("--json", help="Print one JSON object on stdout instead of text and tables.", rich_help_panel=OUTPUT),
]
BundleArgument = Annotated[Path, typer.Argument(help="Folder of a bundle.", metavar="BUNDLE", rich_help_panel=INPUT)]
SourceArgument = Annotated[
    str,
    typer.Argument(
        help="A scene folder, trusted:FOLDER if its images are outside, nuscenes:ROOT[@VERSION][/SPLIT] or "
        "synthetic:SEED[:FRAMES].",
        metavar="SOURCE",
        rich_help_panel=INPUT,
    ),
]
SourcesArgument = Annotated[
    list[str],
    typer.Argument(
        help="Scene folders, trusted:FOLDER if the images are outside, nuscenes:ROOT[@VERSION][/SPLIT] or "
        "synthetic:SEED[:FRAMES]. Several sources follow one another; the history is reset between them.",
        metavar="SOURCE",
        rich_help_panel=INPUT,
    ),
]
