"""The protocol of every frame source: scene folders, synthetic drives and recordings."""

from collections.abc import Iterable, Iterator
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ..runtime.frame import Frame


class Source(Protocol):
    """A sequence of frames in time order. Iterating twice gives the same frames twice.

    identity: a text that is equal for two sources only if their frames are equal.
    tokens: the token of each frame, in order.
    """

    @property
    def identity(self) -> str: ...

    @property
    def tokens(self) -> Iterable[str]: ...

    def __len__(self) -> int: ...

    def __iter__(self) -> Iterator[Frame]: ...

    def frame(self, index: int) -> Frame:
        """Return frame `index`, counted from 0."""

    def frame_without_images(self, index: int) -> Frame:
        """Return frame `index` without images and ground truth. Faster than `frame`."""

    def has_boxes(self, index: int) -> bool:
        """Return whether the ground-truth boxes of frame `index` are known, without computing them."""

    def ground_truth_boxes(self, index: int) -> NDArray[np.float64] | None:
        """Return the ground-truth boxes (D, 9) of frame `index`, or None if unknown. Faster than `frame`.

        Columns as in `GroundTruth.boxes`, in the ego frame of that frame.
        """
