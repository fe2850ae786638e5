"""The arrangement of panels in a picture: side by side, below each other, and padded."""

from collections.abc import Sequence

import numpy as np

from .canvas import Picture, blank
from .frame_picture import BACKGROUND_COLOUR

GAP_PX = 6


def place_beside(pictures: Sequence[Picture], gap_px: int = GAP_PX) -> Picture:
    """Place pictures (H, W, 3) side by side, with gaps. Lower pictures are padded below."""
    height_px = max((len(picture) for picture in pictures), default=1)
    gap = blank(gap_px, height_px, BACKGROUND_COLOUR)
    padded = [pad(picture, picture.shape[1], height_px) for picture in pictures]
    return np.concatenate([part for picture in padded for part in (gap, picture)][1:] or [gap], axis=1)


def place_below(pictures: Sequence[Picture]) -> Picture:
    """Place pictures (H, W, 3) of one width below each other, with gaps."""
    gap = blank(pictures[0].shape[1] if pictures else 1, GAP_PX, BACKGROUND_COLOUR)
    return np.concatenate([part for picture in pictures for part in (gap, picture)][1:] or [gap])


def pad(picture: Picture, width_px: int, height_px: int, centred: bool = False) -> Picture:
    """Extend a picture (H, W, 3) to a larger size: at the bottom, and at the right or, if centred, at both sides."""
    if picture.shape[:2] == (height_px, width_px):
        return picture
    padded = blank(width_px, height_px, BACKGROUND_COLOUR)
    left = (width_px - picture.shape[1]) // 2 if centred else 0
    padded[: len(picture), left : left + picture.shape[1]] = picture
    return padded
