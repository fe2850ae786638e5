"""Training: how DuoSpaceNet learns."""

from .grid_mask import GridMask
from .initialisation import initialise

__all__ = ["GridMask", "initialise"]
