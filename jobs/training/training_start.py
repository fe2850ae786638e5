"""The start of a training in a folder: a new one, or one that was interrupted."""

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ...runtime.errors import ArtifactError, OutputError, UsageError
from ..notify import Notify, ignore
from ..output_folder import check_writable
from ..resuming import check_same_settings

if TYPE_CHECKING:
    from ...training import Trainer, TrainingFolder

CURVES_NAME = "losses.png"
TENSORBOARD_NAME = "tensorboard"


def check_training_folder(out: Path, resume: bool) -> None:
    """Check that a training may start in `out`, or be resumed there. Changes nothing.

    Raises OutputError for the folder of another training, or files that no training wrote. Raises UsageError if there
    is nothing to resume.
    """
    from ...training.training_folder import BEST_NAME, CHECKPOINT_NAME, LOG_NAME, TRAINING_NAME, WEIGHTS_NAME

    check_writable(out)
    exists = (out / TRAINING_NAME).exists()
    if resume and not exists:
        raise UsageError(f"--resume: expected {TRAINING_NAME} in {out}; got none. Leave --resume out to start.")
    if exists and not resume:
        raise OutputError(f"{out}: an earlier training wrote this folder. Choose another --out, or add --resume.")
    names = (CHECKPOINT_NAME, LOG_NAME, WEIGHTS_NAME, BEST_NAME, CURVES_NAME, TENSORBOARD_NAME)
    for name in () if exists else names:
        if (out / name).exists():
            raise OutputError(
                f"{out / name}: no {TRAINING_NAME} shows that a training wrote this file. Choose another --out."
            )


def begin_or_resume(folder: "TrainingFolder", trainer: "Trainer", resume: bool, notify: Notify = ignore) -> None:
    """Write the record of a new training, or load the state of an interrupted one.

    A training may be resumed with more steps. The learning rates of the remaining steps are then those of the longer
    training, and the record says so, see `Extension`.

    Raises UsageError if the interrupted training has another record, ArtifactError for files that cannot be read.
    """
    from ...training.training_record import Extension

    if not resume:
        folder.write_record()
        folder.resume(trainer)
        return
    recorded = folder.read_record()
    _check_same_record(folder, recorded)
    folder.resume(trainer)
    read_extensions(folder)
    old_steps, new_steps = recorded["steps"], trainer.settings.steps
    if new_steps > old_steps:
        extension = Extension(trainer.step, old_steps, new_steps)
        folder.record = replace(folder.record, extended=(*folder.record.extended, extension))
        folder.write_record()
        notify(
            f"the training is extended from {old_steps} to {new_steps} steps; after step {trainer.step}, the learning "
            f"rate follows the schedule of {new_steps} steps"
        )


def read_extensions(folder: "TrainingFolder") -> None:
    """Read the extensions of the training into `folder.record`. Raises ArtifactError if they cannot be read."""
    from ...training.training_folder import TRAINING_NAME
    from ...training.training_record import Extension

    fields, recorded = Extension._fields, folder.read_record()
    try:
        extended = tuple(Extension(*(int(values[name]) for name in fields)) for values in recorded["extended"])
    except (KeyError, TypeError, ValueError) as error:
        raise ArtifactError(
            f"{folder.path / TRAINING_NAME}: expected the extensions of the training as `extended`; got {error!r}."
        ) from error
    folder.record = replace(folder.record, extended=extended)


def _check_same_record(folder: "TrainingFolder", recorded: Mapping[str, Any]) -> None:
    """Check that a training is resumed with its own settings, or with more steps. Raises UsageError, ArtifactError."""
    from ...training.training_folder import TRAINING_NAME
    from ...training.training_record import flatten_record

    path = folder.path / TRAINING_NAME
    requested = flatten_record(json.loads(json.dumps(folder.record.to_dict())))  # tuples become lists, as in the file
    for name in ("extended", "steps", "epochs"):  # `epochs` has been converted to `steps`
        requested.pop(name, None)
    # Data and initial weights depend on the settings. They come last, so that a changed setting is named.
    requested["data"] = requested.pop("data")
    label = "start (sha256 of the initial weights)"
    requested[label], recorded = requested.pop("start"), {**recorded, label: recorded.get("start")}
    check_same_settings("training", path, recorded, requested, "choose another --out")
    steps = recorded.get("steps")
    if not isinstance(steps, int):
        raise ArtifactError(f"{path}: expected the number of steps of the training; got {steps!r}.")
    if steps > folder.record.settings.steps:
        raise UsageError(
            f"--resume: {path}: the training has steps {steps}; got {folder.record.settings.steps}. A training may be "
            "resumed with more steps, not with fewer. Use the same number of steps, or choose another --out."
        )
