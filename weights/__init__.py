"""Checkpoints: how their files are read, whose names they have, how they fit a model; and the weights that ship."""

from .checkpoint import load_checkpoint, read_checkpoint, save_checkpoint
from .checkpoint_file import CheckpointError
from .checkpoint_report import CheckpointReport
from .shipped import shipped_weights

__all__ = [
    "CheckpointError",
    "CheckpointReport",
    "load_checkpoint",
    "read_checkpoint",
    "save_checkpoint",
    "shipped_weights",
]
