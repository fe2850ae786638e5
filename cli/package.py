"""`duospacenet package`: package a bundle for an inference server."""

from pathlib import Path
from typing import Annotated

import typer

from .options import (
    ADVANCED,
    BEHAVIOUR,
    OUTPUT,
    BundleArgument,
    HistoryStepOption,
    JsonOption,
)
from .plain_help import PlainHelpCommand, PlainHelpGroup

OutArgument = Annotated[
    Path, typer.Argument(help="New folder to write.", metavar="OUT", show_default=False, rich_help_panel=OUTPUT)
]
VehiclesOption = Annotated[
    int,
    typer.Option(
        help="Vehicles that are served at the same time. Further vehicles wait.",
        metavar="N",
        min=1,
        rich_help_panel=BEHAVIOUR,
    ),
]
IdleOption = Annotated[
    float,
    typer.Option(
        "--idle-seconds",
        help="A vehicle without a request for this long loses its place and its history. Choose it far above the time "
        "of a frame, waiting included.",
        metavar="SECONDS",
        rich_help_panel=BEHAVIOUR,
    ),
]
OnMissingOption = Annotated[
    str,
    typer.Option(
        help="If a camera is lost: blank uses the other cameras; skip skips the frame; error refuses it.",
        metavar="blank|skip|error",
        rich_help_panel=BEHAVIOUR,
    ),
]
OverwriteOption = Annotated[
    bool,
    typer.Option("--overwrite", help="Replace a folder that this command wrote.", rich_help_panel=BEHAVIOUR),
]
NameOption = Annotated[
    str, typer.Option(help="Name of the model on the server.", metavar="NAME", rich_help_panel=ADVANCED)
]
InstancesOption = Annotated[
    int,
    typer.Option(
        help="Processes that run the bundle, each with its share of the vehicles and the cores.",
        metavar="N",
        min=1,
        rich_help_panel=ADVANCED,
    ),
]
ThreadsOption = Annotated[
    int | None,
    typer.Option(
        help="Threads of each process. Default: its share of the server's cores.",
        metavar="N",
        min=1,
        rich_help_panel=ADVANCED,
    ),
]

app = typer.Typer(cls=PlainHelpGroup, add_completion=False, rich_markup_mode=None, pretty_exceptions_enable=False)


@app.callback()
def package() -> None:
    """Package a bundle for an inference server."""


@app.command(cls=PlainHelpCommand)
def triton(
    bundle: BundleArgument,
    out: OutArgument,
    vehicles: VehiclesOption = 8,
    idle_seconds: IdleOption = 60.0,
    on_missing: OnMissingOption = "blank",
    history_step: HistoryStepOption = None,
    overwrite: OverwriteOption = False,
    name: NameOption = "duospacenet",
    instances: InstancesOption = 1,
    threads: ThreadsOption = None,
    as_json: JsonOption = False,
) -> None:
    """Write a Triton model repository that serves many vehicles.

    Its README says how to install and start the server.

    \b
    Example:
      duospacenet package triton out/bundle out/models --vehicles 8
    """
    from .. import jobs
    from ..jobs.serving.serving_options import ServingOptions
    from .console import print_json, print_message

    options = ServingOptions(name, vehicles, idle_seconds, instances, threads, on_missing, history_step)
    written = jobs.package_triton(bundle, out, options, overwrite=overwrite)
    if as_json:
        print_json(written.to_dict())
        return
    print_message(
        f"wrote {out}: model {name} for {vehicles} vehicles, with {written.state_mb:.0f} MB of history for each"
    )
