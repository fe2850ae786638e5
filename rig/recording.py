"""A source that is looked at without being believed: calibrations may be broken, pictures may not be there."""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from ..data.images import read_image, read_image_size
from ..data.scene_folder import SceneFolder
from ..data.source import Source
from ..runtime.errors import InputError
from ..runtime.frame import Frame


class CameraImage(NamedTuple):
    """A camera's picture in one frame, as far as there is one.

    path: its file; image: (height, width, 3) uint8 BGR of whatever size; size_px: that width and height.
    error: with which the pipeline would refuse it. All of them None for a lost camera.
    """

    path: Path | None = None
    image: NDArray[np.uint8] | None = None
    size_px: tuple[int, int] | None = None
    error: InputError | None = None


class Recording(Protocol):
    """Frames by index, in parts: what is said about them, and what is seen in them."""

    def __len__(self) -> int: ...

    def camera_names(self) -> list[str]:
        """The cameras of all frames, as they come."""

    def frame_without_images(self, index: int) -> Frame:
        """A frame without its pictures and truth, its calibrations and pose not checked."""

    def camera_images(self, index: int) -> dict[str, CameraImage]:
        """The pictures of a frame, by camera."""


class FolderRecording:
    """The frames of a scene folder."""

    def __init__(self, folder: SceneFolder) -> None:
        self._folder = folder

    def __len__(self) -> int:
        return len(self._folder)

    def camera_names(self) -> list[str]:
        frames = map(self.frame_without_images, range(len(self)))
        return list(dict.fromkeys(name for frame in frames for name in frame.cameras))

    def frame_without_images(self, index: int) -> Frame:
        return self._folder.frame_without_images(index)

    def camera_images(self, index: int) -> dict[str, CameraImage]:
        cameras = self.frame_without_images(index).cameras
        return {
            name: _read(self._folder.image_path(index, name), (camera.width_px, camera.height_px))
            for name, camera in cameras.items()
        }


class SourceRecording:
    """The frames of any source, which it has checked itself."""

    def __init__(self, source: Source) -> None:
        self._source = source

    def __len__(self) -> int:
        return len(self._source)

    def camera_names(self) -> list[str]:
        return list(
            dict.fromkeys(name for index in range(len(self)) for name in self.frame_without_images(index).cameras)
        )

    def frame_without_images(self, index: int) -> Frame:
        return self._source.frame_without_images(index)

    def camera_images(self, index: int) -> dict[str, CameraImage]:
        images = self._source.frame(index).images
        return {name: _photo(None, image) for name, image in images.items() if image is not None}


def spread(num_frames: int, wanted: int) -> Sequence[int]:
    """At most `wanted` indices of frames, the first and the last among them, evenly between."""
    return sorted(set(np.linspace(0, num_frames - 1, min(wanted, num_frames)).round().astype(int).tolist()))


def _read(path: Path | None, expected_px: tuple[int, int]) -> CameraImage:
    """A picture as the pipeline reads it; where it is refused, as much of it as there is."""
    if path is None:
        return CameraImage()
    try:
        return _photo(path, read_image(path, *expected_px))
    except InputError as error:
        refused = error
    try:
        size_px = read_image_size(path)
        return _photo(path, read_image(path, *size_px))._replace(error=refused)
    except InputError:  # not of another size, but no picture
        return CameraImage(path, error=refused)


def _photo(path: Path | None, image: NDArray[np.uint8]) -> CameraImage:
    return CameraImage(path, image, (image.shape[1], image.shape[0]))
