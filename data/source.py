"""Where frames come from: a scene folder, or a drawn drive."""

from collections.abc import Iterable, Iterator
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ..runtime.frame import Frame


class Source(Protocol):
    """Frames in time order; iterating twice gives the same frames twice.

    identity: words that two sources share only if their frames are the same. tokens: the frames' own, in their order.
    """

    @property
    def identity(self) -> str: ...

    @property
    def tokens(self) -> Iterable[str]: ...

    def __len__(self) -> int: ...

    def __iter__(self) -> Iterator[Frame]: ...

    def frame(self, index: int) -> Frame: ...

    def frame_without_images(self, index: int) -> Frame:
        """Frame `index` without its images and truth, with less work than all of it."""

    def has_boxes(self, index: int) -> bool:
        """Whether the true boxes of frame `index` are known, without them."""

    def ground_truth_boxes(self, index: int) -> NDArray[np.float64] | None:
        """The true boxes (D, 9) of frame `index`, with less work than all of it; None where they are not known."""
