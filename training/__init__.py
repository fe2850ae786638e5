"""Training of DuoSpaceNet."""

from .initialisation import initialise
from .samples.grid_mask import GridMask
from .settings import Settings
from .trainer import Trainer
from .training_folder import TrainingFolder
from .training_loop import train
from .training_record import TrainingRecord

__all__ = ["GridMask", "Settings", "Trainer", "TrainingFolder", "TrainingRecord", "initialise", "train"]
