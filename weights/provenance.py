"""The provenance of a model's weights, as the manifest records it."""

import hashlib
from pathlib import Path

import torch

from ..model import DuoSpaceNet
from ..runtime.bundle.manifest import CheckpointRecord, WeightsRecord, sha256
from .checkpoint_file import checkpoint_files
from .checkpoint_folder import find_checkpoint
from .checkpoint_report import CheckpointReport
from .trained_parts import loaded_parts


def record_random_weights(model: DuoSpaceNet, seed: int) -> WeightsRecord:
    """The provenance of weights from `randomise(model, seed)`."""
    return WeightsRecord(source=f"random, seed {seed}", sha256=hash_weights(model), trained=False)


def record_checkpoint_weights(
    model: DuoSpaceNet, path: Path, report: CheckpointReport, seed: int, weights_key: str | None = None
) -> WeightsRecord:
    """The provenance of weights from a checkpoint.

    model: the model with the loaded weights.
    path: the checkpoint.
    report: the report of its loading. The metadata of the file may say which parts are trained, see `trained_parts`.
    seed: the seed of the random values of tensors that the checkpoint lacks.
    weights_key: the key that was given to choose one of several copies of the weights.
    """
    partly_random = bool(report.allowed_missing)
    parts = set(loaded_parts(model.config, report).values())
    trained = False if partly_random or False in parts else (None if None in parts else True)
    record = CheckpointRecord(
        layout=report.layout,
        wrappers=report.wrappers,
        matched=len(report.matched),
        missing=report.allowed_missing,
        seed=seed if partly_random else None,
        left_aside=report.left_aside,
        notes=report.notes,
        ignored=report.ignored,
        weights_key=weights_key,
    )
    return WeightsRecord(
        source=find_checkpoint(path).name,
        sha256=hash_weights(model),
        file_sha256=hash_checkpoint(path),
        trained=trained,
        checkpoint=record,
    )


def hash_checkpoint(path: Path) -> str:
    """The sha256 of a checkpoint file.

    Of a sharded checkpoint, it is the hash of the lines that `sha256sum` prints for the index and all shards, sorted
    by file name.
    """
    files = checkpoint_files(path)
    if len(files) == 1:
        return sha256(files[0])
    lines = "".join(f"{sha256(file)}  {file.name}\n" for file in files)
    return hashlib.sha256(lines.encode()).hexdigest()


def hash_weights(model: DuoSpaceNet) -> str:
    """The sha256 of the names and the bytes of all tensors in the model's state dict."""
    digest = hashlib.sha256()
    for name, tensor in model.state_dict().items():
        digest.update(name.encode())
        digest.update(tensor.detach().cpu().contiguous().flatten().view(torch.uint8).numpy())
    return digest.hexdigest()
