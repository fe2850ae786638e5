"""A recording: a source that is read without validation, so that broken calibrations and images can be examined."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..data.images import read_image, read_image_size
from ..data.source import FileSource, Source
from ..runtime.errors import InputError
from ..runtime.frame import Frame, GroundTruth


class CameraImage(NamedTuple):
    """A camera's image in one frame. All fields are None for a lost camera.

    path: the image file; None for an image that does not come from a file.
    image: (height, width, 3) uint8 BGR, of any size; None if it cannot be read.
    size_px: width and height of the image.
    error: the error that the pipeline would raise for this image.
    """

    path: Path | None = None
    image: NDArray[np.uint8] | None = None
    size_px: tuple[int, int] | None = None
    error: InputError | None = None

    @property
    def valid_image(self) -> NDArray[np.uint8] | None:
        """The image, or None if the pipeline would not accept it."""
        return self.image if self.error is None else None


class Recording(ABC):
    """The frames of a source by index, with calibrations and images read separately.

    has_fast_ground_truth: whether reading the boxes of a frame takes much less time than reading its images.
    """

    has_fast_ground_truth = False

    def __init__(self, source: Source) -> None:
        self._source = source

    def __len__(self) -> int:
        return len(self._source)

    def frame_without_images(self, index: int) -> Frame:
        """A frame without images and ground truth. Its calibrations and pose are not validated here."""
        return self._source.frame_without_images(index)

    def ground_truth(self, index: int) -> GroundTruth | None:
        """The ground truth of a frame without maps; None if its boxes are unknown."""
        return self._source.ground_truth_without_maps(index)

    @abstractmethod
    def camera_images(self, index: int) -> dict[str, CameraImage]:
        """The images of a frame, by camera."""

    def camera_names(self) -> list[str]:
        """The names of all cameras, in order of appearance."""
        frames = map(self.frame_without_images, range(len(self)))
        return list(dict.fromkeys(name for frame in frames for name in frame.cameras))


class FileRecording(Recording):
    """The frames of a source whose images are files."""

    has_fast_ground_truth = True

    def __init__(self, source: FileSource) -> None:
        super().__init__(source)
        self._files = source

    def camera_images(self, index: int) -> dict[str, CameraImage]:
        cameras = self.frame_without_images(index).cameras
        return {
            name: _read_unchecked(self._files.image_path(index, name), (camera.width_px, camera.height_px))
            for name, camera in cameras.items()
        }


class SourceRecording(Recording):
    """The frames of any other source. Such a source validates its calibrations and images itself."""

    def camera_images(self, index: int) -> dict[str, CameraImage]:
        images = self._source.frame(index).images
        return {name: _camera_image(None, image) for name, image in images.items()}


def evenly_spaced(num_frames: int, num_selected: int) -> Sequence[int]:
    """At most `num_selected` frame indices, evenly spaced from the first frame to the last."""
    num_selected = min(num_selected, num_frames)
    return sorted(set(np.linspace(0, num_frames - 1, num_selected).round().astype(int).tolist()))


def _read_unchecked(path: Path | None, expected_px: tuple[int, int]) -> CameraImage:
    """Read an image as the pipeline does. If that fails, keep the error and read the image at its own size."""
    if path is None:
        return CameraImage()
    try:
        return _camera_image(path, read_image(path, *expected_px))
    except InputError as exception:
        error = exception
    try:
        size_px = read_image_size(path)
        return _camera_image(path, read_image(path, *size_px))._replace(error=error)
    except InputError:  # the file is not an image, or is incomplete
        return CameraImage(path, error=error)


def _camera_image(path: Path | None, image: NDArray[np.uint8] | None) -> CameraImage:
    return CameraImage() if image is None else CameraImage(path, image, (image.shape[1], image.shape[0]))
