"""The commands by name. The module of a command is imported when the command is called."""

from collections.abc import Callable, Iterator, Mapping
from functools import cache
from importlib import import_module
from typing import Annotated, Any, NamedTuple

import typer
from typer.main import get_command

from duospacenet import __version__  # absolute: package/__init__.py is not beside this folder

from .plain_help import PlainHelpCommand, PlainHelpGroup


class CommandEntry(NamedTuple):
    """A line of the command list.

    place: "module:name" in this folder, of a function or of a Typer application with subcommands.
    """

    place: str
    summary: str


COMMANDS = {
    "demo": CommandEntry("demo:demo", "Export, check, run and evaluate the shipped weights on a synthetic scene."),
    "export": CommandEntry("export:export", "Export weights to a bundle of ONNX graphs and check its parity."),
    "run": CommandEntry("run:run", "Detect the objects in every frame of a source."),
    "batch": CommandEntry("batch:batch", "Detect the objects in many scenes, with several workers or on a cluster."),
    "parity": CommandEntry("parity:parity", "Compare a bundle with its model in PyTorch."),
    "bench": CommandEntry("bench:bench", "Measure the speed and memory of a bundle, beside alternatives."),
    "inspect": CommandEntry("inspect:inspect", "Show the contents of a bundle, or the size of a model."),
    "quantize": CommandEntry("quantize:quantize", "Quantize a float32 bundle to int8, if its metrics hold."),
    "sign": CommandEntry("sign:sign", "Sign a bundle with a private key."),
    "verify": CommandEntry("verify:verify", "Check a bundle against its signature."),
    "package": CommandEntry("package:app", "Package a bundle for an inference server."),
    "eval": CommandEntry("evaluate:evaluate", "Compute the nuScenes metrics of a bundle or of a submission."),
    "compare": CommandEntry("compare:compare", "Draw several results beside one ground truth."),
    "check-rig": CommandEntry("check_rig:check_rig", "Check the calibration, times and images of a camera rig."),
    "anchors": CommandEntry("anchors:anchors", "Compute initial query positions from ground-truth boxes."),
    "config": CommandEntry("config:app", "Print model configurations to start your own from."),
    "schema": CommandEntry("schema:schema", "Print the JSON Schema of a manifest, results or scene file."),
    "train": CommandEntry("train:train", "Train a model."),
    "synthetic": CommandEntry("synthetic:synthetic", "Write synthetic scenes as a nuScenes root or a scene folder."),
}


class CommandTable(Mapping[str, Any]):
    """The commands by name; each is imported and built when it is looked up."""

    def __getitem__(self, name: str) -> Any:
        return load_command(name)

    def __iter__(self) -> Iterator[str]:
        return iter(COMMANDS)

    def __len__(self) -> int:
        return len(COMMANDS)


class CommandGroup(PlainHelpGroup):
    """The top-level command. Its help comes from the summaries, so that it imports no command."""

    def __init__(self, **attributes: Any) -> None:
        super().__init__(**attributes)
        self.commands = CommandTable()  # type: ignore[assignment]

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        with formatter.section("Commands"):
            formatter.write_dl([(name, entry.summary) for name, entry in COMMANDS.items()])


@cache
def load_command(name: str) -> Any:
    """Import a command and build it. Raises KeyError for an unknown name."""
    module, attribute = COMMANDS[name].place.split(":")
    command: Callable[..., Any] | typer.Typer = getattr(import_module(f".{module}", __package__), attribute)
    if isinstance(command, typer.Typer):
        return get_command(command)
    single = typer.Typer(add_completion=False, rich_markup_mode=None, pretty_exceptions_enable=False)
    single.command(name, cls=PlainHelpCommand)(command)
    return get_command(single)


EXIT_CODES = (
    "Exit codes: 0 success, 1 a check failed, 2 usage, 3 bad input data, 4 bad checkpoint or bundle, 5 I/O, "
    "6 a missing extra, 70 an internal error, 130 interrupted."
)

app = typer.Typer(
    name="duospacenet", cls=CommandGroup, epilog=EXIT_CODES, rich_markup_mode=None, pretty_exceptions_enable=False
)


def print_version(wanted: bool) -> None:
    """Print the version and end the command, if `--version` was given."""
    if wanted:
        typer.echo(f"duospacenet {__version__}")
        raise typer.Exit


@app.callback()
def duospacenet(
    version: Annotated[
        bool, typer.Option("--version", callback=print_version, is_eager=True, help="Show the version and exit.")
    ] = False,
) -> None:
    """Export DuoSpaceNet to ONNX, check the export against PyTorch, and run it on a CPU."""
