"""Which objects are visible in at least one camera."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from .camera_renderer import RenderedImage

LEAST_VISIBLE_PX = 4
LEAST_VISIBLE_SHARE = 0.15


def is_box_visible(rendered: Sequence[RenderedImage]) -> NDArray[np.bool_]:
    """Whether at least one image shows enough of each box, (D,).

    rendered: the image of each camera.

    Enough means at least 4 pixels, and at least 15 % of the pixels that the box would have without other objects in
    front of it.
    """
    num_boxes = len(rendered[0].num_unoccluded)
    num_visible = np.array([np.bincount(image.ids.ravel(), minlength=num_boxes + 1)[1:] for image in rendered])
    num_unoccluded = np.array([image.num_unoccluded for image in rendered])
    is_enough = (num_visible >= LEAST_VISIBLE_PX) & (num_visible >= LEAST_VISIBLE_SHARE * num_unoccluded)
    return np.logical_or.reduce(is_enough)
