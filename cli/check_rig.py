"""`duospacenet check-rig`: check a rig's calibration, times and pictures."""

from pathlib import Path
from typing import Annotated, Any

import typer

from .console import print_json, print_message, print_result, show_progress
from .options import BEHAVIOUR, INPUT, OUTPUT, JsonOption, SourceArgument

OutOption = Annotated[
    Path,
    typer.Option(
        help="Folder for rig.json, coverage.png and cameras/.",
        metavar="FOLDER",
        show_default=False,
        rich_help_panel=OUTPUT,
    ),
]
BundleOption = Annotated[
    Path | None,
    typer.Option(help="Use this bundle's perception range and image crop.", metavar="FOLDER", rich_help_panel=INPUT),
]
FramesOption = Annotated[
    int,
    typer.Option(
        help="Number of frames with images to check, evenly spaced over the source. From 4 on, a run of up to five "
        "frames is added, whose images are compared with each other.",
        min=1,
        metavar="N",
        rich_help_panel=BEHAVIOUR,
    ),
]
OverwriteOption = Annotated[
    bool,
    typer.Option(
        "--overwrite",
        help="Replace the files of an earlier check in --out, once this check is complete.",
        rich_help_panel=BEHAVIOUR,
    ),
]
StrictOption = Annotated[
    bool, typer.Option("--strict", help="Exit with 1 if a part is suspect, too.", rich_help_panel=BEHAVIOUR)
]


def check_rig(
    source: SourceArgument,
    out: OutOption,
    bundle: BundleOption = None,
    frames: FramesOption = 8,
    overwrite: OverwriteOption = False,
    strict: StrictOption = False,
    as_json: JsonOption = False,
) -> None:
    """Check a rig. Exit code 1 if a camera, the drive's times or poses, or the ground truth are broken.

    ok: no problem was found. not judged: too little evidence, for example too short a drive. suspect: look at the
    pictures to decide. broken: the numbers cannot be right. With --strict, suspect has exit code 1, too.

    \b
    Example:
      duospacenet check-rig my_scene --out out/rig
    """
    from .. import jobs
    from ..jobs.rig_check import REPORT_NAME
    from ..runtime.errors import CheckError
    from .rig_table import print_rig

    callbacks: dict[str, Any] = {"progress": show_progress, "notify": print_message}
    check = jobs.check_rig(source, out, bundle=bundle, num_frames=frames, overwrite=overwrite, **callbacks)
    if as_json:
        print_json(check.report)
    else:
        print_rig(check)
        print_result(f"pictures and all numbers in {out}", markup=False, soft_wrap=True)
    parts = {"broken": check.broken, "suspect": check.suspect if strict else []}
    if any(parts.values()):
        text = "; ".join(f"{verdict}: {', '.join(names)}" for verdict, names in parts.items() if names)
        raise CheckError(f"{text}. See {out / REPORT_NAME} and the pictures beside it.")
