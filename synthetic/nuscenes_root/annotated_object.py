"""One object in one frame, as it is annotated."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray


class AnnotatedObject(NamedTuple):
    """An object in one frame.

    identity: integers that identify the object within its scene.
    category: one of the 23 categories of nuScenes.
    box: (9,) x y z w l h [m], yaw [rad], vx vy [m/s] in the global frame of the root. nuScenes annotates no velocity;
        the tables give it as the difference of positions.
    visible_share: of the pixels that the object would have without others in front of it, over all cameras, 0..1.
    num_lidar_points, num_radar_points: in the box.
    """

    identity: tuple[int, ...]
    category: str
    box: NDArray[np.float64]
    visible_share: float
    num_lidar_points: int
    num_radar_points: int
