"""Training: how DuoSpaceNet learns."""

from .grid_mask import GridMask
from .initialisation import initialise
from .run import Training, TrainingFolder, train
from .settings import Settings
from .trainer import Trainer

__all__ = ["GridMask", "Settings", "Trainer", "Training", "TrainingFolder", "initialise", "train"]
