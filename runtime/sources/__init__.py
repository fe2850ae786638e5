"""Where frames come from: a scene folder, or a drawn drive."""

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ..frame import Frame


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

    def blind_frame(self, index: int) -> Frame:
        """Frame `index` without its images and truth, with less work than all of it."""

    def true_boxes(self, index: int) -> NDArray[np.float64] | None:
        """The true boxes (D, 9) of frame `index`, with less work than all of it; None where they are not known."""


def open_source(spec: str) -> Source:
    """Open `synthetic:SEED[:FRAMES]` or a scene folder.

    Raises InputError when there is no such source.
    """
    from .scene_folder import SceneFolder
    from .synthetic import SyntheticDrive

    if spec.startswith("synthetic:"):
        return SyntheticDrive.parse(spec)
    return SceneFolder(Path(spec))


def spread(num_frames: int, wanted: int) -> Sequence[int]:
    """At most `wanted` indices of frames, the first and the last among them, evenly between."""
    return sorted(set(np.linspace(0, num_frames - 1, min(wanted, num_frames)).round().astype(int).tolist()))
