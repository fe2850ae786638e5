"""One scene of a source, as a source: its frames are consecutive frames of the whole source."""

from collections.abc import Collection, Iterator
from itertools import groupby, islice
from typing import NamedTuple

from ..runtime.frame import Frame, GroundTruth
from .source import Source


class ScenePiece(NamedTuple):
    """Consecutive frames of one scene.

    name: of the scene. first: index of its first frame in the source. frames: their number.
    """

    name: str
    first: int
    frames: int


def find_pieces(source: Source) -> list[ScenePiece]:
    """The pieces of a source, in order. A scene whose frames are not consecutive has several."""
    names = (source.scene_name(index) for index in range(len(source)))
    pieces, first = [], 0
    for name, group in groupby(names):
        frames = sum(1 for _ in group)
        pieces.append(ScenePiece(name, first, frames))
        first += frames
    return pieces


class OneScene:
    """The frames of one piece of a source, counted from 0."""

    def __init__(self, source: Source, piece: ScenePiece) -> None:
        self._source, self._piece = source, piece

    @property
    def identity(self) -> str:
        """The identity of the source, with the name and the frames of the scene if the source has other frames too."""
        if self._piece.frames == len(self._source):
            return self._source.identity
        first, last = self._piece.first, self._piece.first + self._piece.frames - 1
        return f"{self._source.identity}, scene {self._piece.name!r}, frames {first} to {last}"

    @property
    def tokens(self) -> Iterator[str]:
        first = self._piece.first
        return islice(iter(self._source.tokens), first, first + self._piece.frames)

    def __len__(self) -> int:
        return self._piece.frames

    def __iter__(self) -> Iterator[Frame]:
        return map(self.frame, range(len(self)))

    def frame(self, index: int) -> Frame:
        """Return frame `index` of the scene, counted from 0."""
        return self._source.frame(self._place(index))

    def frame_without_images(self, index: int) -> Frame:
        """Return frame `index` of the scene without images and ground truth."""
        return self._source.frame_without_images(self._place(index))

    def scene_name(self, index: int) -> str:
        """Return the name of the scene."""
        return self._source.scene_name(self._place(index))

    def check_image_files(self, index: int) -> tuple[str, ...]:
        """Check the image files of frame `index`. Returns the names of the lost cameras. Raises InputError."""
        return self._source.check_image_files(self._place(index))

    def has_boxes(self, index: int) -> bool:
        """Return whether the ground-truth boxes of frame `index` are known."""
        return self._source.has_boxes(self._place(index))

    def has_maps(self, index: int) -> bool:
        """Return whether any ground-truth map of frame `index` is known."""
        return self._source.has_maps(self._place(index))

    def map_names(self, index: int) -> frozenset[str]:
        """Return the names of the known ground-truth maps of frame `index`."""
        return self._source.map_names(self._place(index))

    def ground_truth_without_maps(self, index: int) -> GroundTruth | None:
        """Return the ground truth of frame `index` without maps, or None if its boxes are unknown."""
        return self._source.ground_truth_without_maps(self._place(index))

    def check_class_names(self, classes: Collection[str]) -> None:
        """Check the class names of the whole source. Raises InputError."""
        self._source.check_class_names(classes)

    def _place(self, index: int) -> int:
        """The index in the source of frame `index` of the scene."""
        if not 0 <= index < len(self):
            raise IndexError(index)
        return self._piece.first + index
