"""Reading, loading and saving checkpoints of this toolkit and of other code bases, and the shipped trained weights."""

from .checkpoint import load_checkpoint, read_checkpoint, save_checkpoint
from .checkpoint_config import read_config
from .checkpoint_error import CheckpointError
from .checkpoint_report import CheckpointReport
from .shipped import shipped_weights

__all__ = [
    "CheckpointError",
    "CheckpointReport",
    "load_checkpoint",
    "read_checkpoint",
    "read_config",
    "save_checkpoint",
    "shipped_weights",
]
