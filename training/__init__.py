"""Training: how DuoSpaceNet learns."""

from .grid_mask import GridMask
from .initialisation import initialise
from .settings import Settings
from .trainer import Trainer
from .training_folder import Training, TrainingFolder, train

__all__ = ["GridMask", "Settings", "Trainer", "Training", "TrainingFolder", "initialise", "train"]
