"""`duospacenet train`: weights from drives, drawn or one's own."""

from collections import deque
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from pydantic import ValidationError

from ..data.source import Source
from ..jobs.models import find_preset, load_weights
from ..jobs.output_folder import check_writable, held, make_folders
from ..jobs.sources import open_source
from ..runtime.errors import OutputError, UsageError
from ..runtime.extras import needs_extra
from ..runtime.json_record import describe_first_error
from .console import print_json, print_message, print_result, show_progress
from .options import AllowMissingOption

if TYPE_CHECKING:
    import torch

    from ..model import DuoSpaceNet, DuoSpaceNetConfig
    from ..training import Settings
    from ..training.clips import Clips
    from ..training.trainer import TrainingStep

CURVES_NAME = "losses.png"
SAID_EVERY = 100  # steps, where there is no terminal to show progress on


def train(
    preset: Annotated[str, typer.Option(help="tiny, nano, small, ...; or an ablation: nano-pv, ...")],
    out: Annotated[Path, typer.Option(help="Folder of the training.")],
    source: Annotated[
        str | None, typer.Option(help="A source with truth; default: new drawn drives without end.")
    ] = None,
    weights: Annotated[Path | None, typer.Option(help="Weights to begin with instead of drawn ones.")] = None,
    allow_missing: AllowMissingOption = None,
    steps: Annotated[int, typer.Option(help="Of the optimiser; the learning rate falls to zero over them.")] = 10_000,
    batch_size: Annotated[int, typer.Option(help="Frames a step, each of a drive of its own.")] = 2,
    frames_per_clip: Annotated[int, typer.Option(help="After so many frames a drive ends.")] = 6,
    learning_rate: Annotated[float, typer.Option(help="At its peak.")] = 4e-4,
    backbone_learning_rate: Annotated[
        float | None, typer.Option(help="Default: the same; a trained backbone wants a tenth.")
    ] = None,
    warmup_steps: Annotated[int, typer.Option(help="Over which the learning rate rises.")] = 200,
    grid_mask: Annotated[float, typer.Option(help="Probability of GridMask at the end.")] = 0.0,
    auxiliary_matches: Annotated[int, typer.Option(help="Queries an object gets in the layers before the last.")] = 3,
    pretraining: Annotated[
        bool,
        typer.Option(
            "--pretraining",
            help="Train the image encoder alone, by a head on PV features: no queries, no BEV, no maps.",
        ),
    ] = False,
    denoising: Annotated[int, typer.Option(help="Sets of queries a frame that begin beside the objects.")] = 1,
    pv_supervision: Annotated[
        bool, typer.Option(help="Let a head find objects in the PV features, too, while they are learned.")
    ] = True,
    bev_supervision: Annotated[bool, typer.Option(help="The same in the BEV features.")] = True,
    bf16: Annotated[bool, typer.Option(help="Convolutions in bfloat16.")] = True,
    seed: Annotated[
        int, typer.Option(help="Of the start, the heads, the drives, the masks and the noise; 0 to 999.")
    ] = 0,
    device: Annotated[str, typer.Option(help="auto, cpu or cuda.")] = "auto",
    workers: Annotated[int, typer.Option(help="Processes that draw the next drives.", min=0)] = 1,
    save_every: Annotated[int, typer.Option(help="Steps between checkpoints, about.", min=1)] = 200,
    resume: Annotated[bool, typer.Option("--resume", help="Go on from the last checkpoint in --out.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="A summary as one JSON object.")] = False,
) -> None:
    """Train a model as the paper does, and keep its weights, its state and its losses in a folder.

    Ctrl-C keeps the last checkpoint; the same command with --resume goes on as if nothing had happened.
    """
    config = find_preset(preset)
    with needs_extra("train"):
        from ..training import Settings, Trainer, TrainingFolder, TrainingRecord
        from ..training import train as train_on
        from ..training.clip_loader import load_clips, remaining_clips
        from ..training.training_folder import WEIGHTS_NAME
    with needs_extra("viz"):
        from ..training.loss_curves import write_loss_curves
    from ..weights.input_contract import preprocessing
    from ..weights.provenance import hash_weights

    try:
        settings = Settings(
            steps=steps,
            batch_size=batch_size,
            frames_per_clip=frames_per_clip,
            learning_rate=learning_rate,
            backbone_learning_rate=learning_rate if backbone_learning_rate is None else backbone_learning_rate,
            warmup_steps=warmup_steps,
            grid_mask=grid_mask,
            auxiliary_matches=auxiliary_matches,
            pretraining=pretraining,
            denoising=denoising,
            pv_supervision=pv_supervision,
            bev_supervision=bev_supervision,
            bf16=bf16,
            seed=seed,
        )
    except ValidationError as error:
        raise UsageError(f"--{describe_first_error(error).replace('_', '-')}") from None
    if allow_missing and weights is None:
        raise UsageError("--allow-missing: expected with --weights FILE; got none, and all is drawn.")
    place = _device(device)
    check_folder(out, resume)
    drives = find_drives(source, settings, config)
    learned = replace(config, map_classes=()) if pretraining else config
    check_first_frame(drives, learned)
    trainer = Trainer(_start(config, settings, drives, weights, allow_missing), settings, place)
    training = TrainingRecord(preset, settings, drives.identity, hash_weights(trainer.model))
    folder = TrainingFolder(out, training)
    make_folders(out, ("",))
    with held(out):
        check_folder(out, resume)  # again: another may have held it until now
        if resume:
            folder.check_record()
        else:
            folder.write_record()
        folder.resume(trainer)
        numbers = remaining_clips(drives, settings, trainer.step)
        samples = load_clips(drives, learned, preprocessing(config), numbers, workers)
        try:
            loss = _follow(train_on(trainer, folder, samples, save_every), preset, trainer.step, steps)
        except BaseException:
            with suppress(Exception):  # what broke it off is to be told, not what the curves lack
                if log := folder.read_log():
                    write_loss_curves(log, out / CURVES_NAME)
            raise
        write_loss_curves(folder.read_log(), out / CURVES_NAME)
    summary = {"weights": str(out / WEIGHTS_NAME), "steps": steps, "loss": loss}
    if as_json:
        print_json(summary)
    else:
        print_result(f"wrote {out / WEIGHTS_NAME} after {steps} steps", markup=False, soft_wrap=True)


def check_folder(out: Path, resume: bool) -> None:
    """See that a training may begin in `out`, or go on there, and change nothing.

    Raises OutputError where another began, or files lie that no training is known to have written; UsageError where
    there is nothing to resume.
    """
    from ..training.training_folder import CHECKPOINT_NAME, LOG_NAME, TRAINING_NAME, WEIGHTS_NAME

    check_writable(out)
    there = (out / TRAINING_NAME).exists()
    if resume and not there:
        raise UsageError(f"--resume: expected {TRAINING_NAME} in {out}; got none. Leave --resume out to begin.")
    if there and not resume:
        raise OutputError(f"{out}: an earlier training wrote it. Choose another --out, or add --resume.")
    for name in () if there else (CHECKPOINT_NAME, LOG_NAME, WEIGHTS_NAME, CURVES_NAME):
        if (out / name).exists():
            raise OutputError(f"{out / name}: no training is known to have written it. Choose another --out.")


def find_drives(source: str | None, settings: "Settings", config: "DuoSpaceNetConfig") -> "Clips":
    """The drives to train on. Raises InputError where a source does not say what stands in one of its frames."""
    from ..training.clips import SourceClips, SyntheticClips
    from ..weights.input_contract import temporal_window

    if source is None:
        return SyntheticClips(settings.seed, settings.frames_per_clip, config.voxels.size[:2])
    opened = open_source(source, config.voxels.size[:2])
    check_truth(opened)
    return SourceClips(opened, settings.seed, settings.frames_per_clip, temporal_window(config))


def check_truth(source: Source) -> None:
    """See that the true boxes of all frames are known, before anything is written. Raises InputError."""
    from ..training.training_frames import missing_boxes_error

    for index, token in enumerate(source.tokens):
        if not source.has_boxes(index):
            raise missing_boxes_error(token)


def check_first_frame(drives: "Clips", config: "DuoSpaceNetConfig") -> None:
    """See that a frame of these drives can be trained on, before anything is written. Raises InputError."""
    from ..training.training_frames import make_training_frame
    from ..weights.input_contract import preprocessing

    make_training_frame(drives.frames(0)[0], config, preprocessing(config))


def _start(
    config: "DuoSpaceNetConfig",
    settings: "Settings",
    drives: "Clips",
    weights: Path | None,
    allow_missing: list[str] | None,
) -> "DuoSpaceNet":
    """The model before its first step: with these weights; what they lack is new, the queries among the objects."""
    from ..model import DuoSpaceNet
    from ..model.queries import place_anchors
    from ..training import initialise
    from ..training.initial_anchors import find_initial_anchors

    model = initialise(DuoSpaceNet(config), settings.seed)
    report = None if weights is None else load_weights(model, weights, allow_missing)
    if report is not None:
        for line in (f"{weights}: {report.verdict}", *(f"note: {note}" for note in report.notes)):
            print_message(line)
    if report is None or "queries.pose" not in report.matched:
        print_message("looking for anchors ...")
        place_anchors(model.queries.pose, find_initial_anchors(drives, config.num_queries, settings.seed))
    return model


def _device(name: str) -> "torch.device":
    """Raises UsageError for a device that is none, or is not there."""
    import torch

    if name not in ("auto", "cpu", "cuda"):
        raise UsageError(f"--device: expected auto, cpu or cuda; got {name!r}.")
    if name == "cuda" and not torch.cuda.is_available():
        raise UsageError("--device: expected a GPU for cuda; torch sees none. Leave it out to train on the CPU.")
    return torch.device("cuda" if name != "cpu" and torch.cuda.is_available() else "cpu")


def _follow(training: "Iterator[TrainingStep]", preset: str, first: int, steps: int) -> float | None:
    """Go through a training from step `first` on, and say how it goes; returns the mean of its last losses."""
    recent: deque[float] = deque(maxlen=SAID_EVERY)
    for step in show_progress(training, f"training {preset}", steps - first):
        recent.append(step.losses["total"])
        if (step.number + 1) % SAID_EVERY == 0:
            print_message(f"step {step.number + 1} of {steps}: loss {sum(recent) / len(recent):.3f}")
    return sum(recent) / len(recent) if recent else None
