"""The protocol of every frame source: scene folders, nuScenes roots, synthetic drives and recordings."""

from collections.abc import Collection, Iterable, Iterator
from pathlib import Path
from typing import Protocol, runtime_checkable

from ..runtime.bundle.preprocessing_record import Preprocessing
from ..runtime.frame import Frame, GroundTruth


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

    def scene_name(self, index: int) -> str:
        """Return the scene of frame `index`. Faster than `frame_without_images`."""

    def check_image_files(self, index: int) -> tuple[str, ...]:
        """Check that the image files of frame `index` can be read and have the right size. No pixel is decoded.

        Returns the names of the lost cameras. Raises InputError, naming the file.
        """

    def has_boxes(self, index: int) -> bool:
        """Return whether the ground-truth boxes of frame `index` are known, without computing them."""

    def has_maps(self, index: int) -> bool:
        """Return whether any ground-truth map of frame `index` is known, without reading it."""

    def map_names(self, index: int) -> frozenset[str]:
        """Return the names of the known ground-truth maps of frame `index`, without reading them."""

    def ground_truth_without_maps(self, index: int) -> GroundTruth | None:
        """Return the ground truth of frame `index` without maps, or None if its boxes are unknown.

        Faster than `frame`.
        """

    def check_class_names(self, classes: Collection[str]) -> None:
        """Check that the boxes of all frames have names that stand for one of these classes or are left out.

        Raises InputError that lists the other names, see `data.class_names`.
        """


@runtime_checkable
class ImageFiles(Protocol):
    """What a source with image files has beside the methods of every source."""

    def image_path(self, index: int, name: str) -> Path | None:
        """Return the image path of camera `name` in frame `index`; None for a lost camera."""

    def with_fast_decoding(self, preprocessing: Preprocessing) -> Source:
        """Return this source with JPEG files decoded at a half or a quarter of their size, where that is enough.

        preprocessing: of the bundle that gets the frames. The cameras of a frame describe its smaller images.
        """


class FileSource(Source, ImageFiles, Protocol):
    """A source whose images are files: a scene folder or a nuScenes root."""
