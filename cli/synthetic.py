"""`duospacenet synthetic`: write scenes of the synthetic world as a nuScenes root or a scene folder."""

from pathlib import Path
from typing import Annotated, Literal

import typer

from .console import print_json, print_result, show_progress
from .options import ADVANCED, BEHAVIOUR, OUTPUT, JsonOption

LISTED_SCENES = 10

OutArgument = Annotated[
    Path, typer.Argument(help="New folder to write.", metavar="OUT", show_default=False, rich_help_panel=OUTPUT)
]
ScenesOption = Annotated[int, typer.Option(help="Number of scenes.", min=1, metavar="N", rich_help_panel=BEHAVIOUR)]
FramesOption = Annotated[
    int, typer.Option(help="Key frames per scene, at 2 Hz.", min=1, max=10000, metavar="N", rich_help_panel=BEHAVIOUR)
]
FormatOption = Annotated[
    Literal["nuscenes", "scene-folder"],
    typer.Option(
        "--format", help="A nuScenes root with all tables and maps, or a scene folder.", rich_help_panel=OUTPUT
    ),
]
SeedOption = Annotated[
    int,
    typer.Option(
        help="Seed of the first scene; each further scene has the next seed.",
        min=0,
        max=10**12,
        metavar="N",
        rich_help_panel=BEHAVIOUR,
    ),
]
SplitOption = Annotated[
    str | None,
    typer.Option(
        help="Split of nuScenes whose scene names are used: mini_train, mini_val, train, val or test. "
        "Default: the names of v1.0-mini for up to 10 scenes, else those of v1.0-trainval.",
        metavar="NAME",
        show_default=False,
        rich_help_panel=ADVANCED,
    ),
]
WidthOption = Annotated[
    int,
    typer.Option(
        "--width",
        help="Width of the images; their height is 9/16 of it.",
        min=160,
        max=3840,
        metavar="PIXELS",
        rich_help_panel=ADVANCED,
    ),
]


def synthetic(
    out: OutArgument,
    scenes: ScenesOption = 1,
    frames: FramesOption = 40,
    file_format: FormatOption = "nuscenes",
    seed: SeedOption = 0,
    split: SplitOption = None,
    width: WidthOption = 1600,
    as_json: JsonOption = False,
) -> None:
    """Write synthetic scenes with exact ground truth as a nuScenes root or a scene folder.

    \b
    Example:
      duospacenet synthetic out/root --scenes 2 --format nuscenes
      duospacenet run out/bundle nuscenes:out/root/mini_val --out out/results
    """
    from .. import jobs

    written = jobs.write_synthetic(out, scenes, frames, seed, file_format, split, width, show_progress)
    if as_json:
        print_json(written.to_dict())
        return
    count = f"{scenes} scene{'' if scenes == 1 else 's'} of {frames} frame{'' if frames == 1 else 's'}"
    names = ", ".join(written.scenes[:LISTED_SCENES]) + (", ..." if scenes > LISTED_SCENES else "")
    text = f"wrote {out}: {count} ({names}); read it as the source {written.source}"
    print_result(text, markup=False, soft_wrap=True)
