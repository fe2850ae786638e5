"""The start of a training in a folder: a new one, or one that was interrupted."""

from pathlib import Path
from typing import TYPE_CHECKING

from ...runtime.errors import OutputError, UsageError
from ..output_folder import check_writable
from ..resuming import check_same_settings

if TYPE_CHECKING:
    from ...training import Trainer, TrainingFolder

CURVES_NAME = "losses.png"


def check_training_folder(out: Path, resume: bool) -> None:
    """Check that a training may start in `out`, or be resumed there. Changes nothing.

    Raises OutputError for the folder of another training, or files that no training wrote. Raises UsageError if there
    is nothing to resume.
    """
    from ...training.training_folder import CHECKPOINT_NAME, LOG_NAME, TRAINING_NAME, WEIGHTS_NAME

    check_writable(out)
    exists = (out / TRAINING_NAME).exists()
    if resume and not exists:
        raise UsageError(f"--resume: expected {TRAINING_NAME} in {out}; got none. Leave --resume out to start.")
    if exists and not resume:
        raise OutputError(f"{out}: an earlier training wrote this folder. Choose another --out, or add --resume.")
    for name in () if exists else (CHECKPOINT_NAME, LOG_NAME, WEIGHTS_NAME, CURVES_NAME):
        if (out / name).exists():
            raise OutputError(
                f"{out / name}: no {TRAINING_NAME} shows that a training wrote this file. Choose another --out."
            )


def begin_or_resume(folder: "TrainingFolder", trainer: "Trainer", resume: bool) -> None:
    """Write the record of a new training, or load the state of an interrupted one.

    Raises UsageError if the interrupted training has another record, ArtifactError for files that cannot be read.
    """
    from ...training.training_folder import TRAINING_NAME
    from ...training.training_record import flatten_record

    if resume:
        requested = flatten_record(folder.record.to_dict())
        record_path = folder.path / TRAINING_NAME
        check_same_settings("training", record_path, folder.read_record(), requested, "choose another --out")
    else:
        folder.write_record()
    folder.resume(trainer)
