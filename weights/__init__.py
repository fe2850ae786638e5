"""Reading, loading and saving checkpoints of this toolkit and of other code bases, and the shipped trained weights.

A checkpoint is read in these steps: `checkpoint_folder.py` (which file), `checkpoint_format.py` (which format),
`checkpoint_file.py` (its content), `checkpoint_wrappers.py` (the weights in it), `checkpoint_layout.py` (whose names),
`tensor_matching.py` (the comparison with the model), `checkpoint_report.py` (the verdict).
"""

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
