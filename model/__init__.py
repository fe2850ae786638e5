"""DuoSpaceNet in PyTorch.

Dimension key, the same in every file:
`B` batch, `N` cameras, `L` feature levels, `H W` height and width of an image or level, `X Y Z` voxels (x forward,
y left, z up), `T` frames in the temporal window including the current one, `Q` queries, `C` channels, `P` sampling
points per level and head.
"""

from .attention import multi_scale_deformable_attention
from .config import DuoSpaceNetConfig
from .duospacenet import DuoSpaceNet
from .presets import PRESETS
from .random_weights import randomise

__all__ = [
    "PRESETS",
    "DuoSpaceNet",
    "DuoSpaceNetConfig",
    "multi_scale_deformable_attention",
    "randomise",
]
