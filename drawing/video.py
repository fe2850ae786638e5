"""Writing pictures as an MP4 video."""

from contextlib import ExitStack
from pathlib import Path
from types import TracebackType
from typing import Self

import cv2
import numpy as np
from numpy.typing import NDArray

from ..runtime.errors import OutputError
from ..runtime.files import move_into_place, output_errors, path_for_native_code, remove_temporary, temporary_path

CODEC = "mp4v"  # MPEG-4 part 2, which every build of OpenCV can encode


class VideoWriter:
    """Writes pictures into a temporary file, which becomes the MP4 file when the block ends.

        with VideoWriter("drive.mp4", frames_per_second=2) as video:
            video.write(picture)

    After an exception inside the block, no file is written, and an existing one is kept. Raises OutputError, naming the
    path, if the video cannot be opened or finished, or if no picture was written.
    """

    def __init__(self, path: Path | str, frames_per_second: float = 2.0) -> None:
        self._path = Path(path)
        self._temporary = temporary_path(self._path)
        self._frames_per_second = frames_per_second
        self._stack = ExitStack()
        self._encoder: cv2.VideoWriter | None = None
        self._shape: tuple[int, ...] = ()
        self._num_frames = 0

    def __enter__(self) -> Self:
        return self

    def write(self, picture: NDArray[np.uint8]) -> None:
        """Append a picture (height, width, 3), uint8 BGR.

        If the height or width is odd, the last row or column is cut off. If a picture has another size than the first
        one, it is scaled to fit into that size, with black borders. This happens if the cameras of a rig change.
        """
        if self._encoder is None:
            self._encoder = self._open(picture)
            self._shape = picture.shape
        self._encoder.write(fit_into(picture, self._shape))
        self._num_frames += 1

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        try:
            if self._encoder is not None:
                self._encoder.release()
            if kind is None:
                self._finish()
        finally:
            self._stack.close()
            remove_temporary(self._temporary)

    def _open(self, picture: NDArray[np.uint8]) -> cv2.VideoWriter:
        height, width = picture.shape[:2]
        with output_errors(self._path):
            folder = self._stack.enter_context(path_for_native_code(self._path.parent))
        name, codec = f"{folder}/{self._temporary.name}", cv2.VideoWriter.fourcc(*CODEC)
        encoder = cv2.VideoWriter(name, codec, self._frames_per_second, (width, height))
        if not encoder.isOpened():
            raise OutputError(
                f"cannot write {self._path}: OpenCV could not open an {CODEC} video of {width}x{height}; "
                "check the folder, and that OpenCV was built with FFmpeg"
            )
        return encoder

    def _finish(self) -> None:
        if self._num_frames == 0:
            raise OutputError(f"cannot write {self._path}: a video needs at least one picture")
        # OpenCV does not report a failed write, for example on a full disk; the file then has fewer frames.
        num_written = count_frames(self._temporary)
        if num_written != self._num_frames:
            raise OutputError(
                f"cannot write {self._path}: only {num_written} of {self._num_frames} pictures were written; "
                "is the disk full?"
            )
        with output_errors(self._path):
            move_into_place(self._temporary, self._path)


def fit_into(picture: NDArray[np.uint8], shape: tuple[int, ...]) -> NDArray[np.uint8]:
    """Scale a picture to fit into `shape` and centre it on black. A picture of this shape is returned unchanged."""
    if picture.shape == shape:
        return picture
    scale = min(shape[0] / picture.shape[0], shape[1] / picture.shape[1])
    height, width = (max(1, int(size * scale)) for size in picture.shape[:2])
    canvas = np.zeros(shape, np.uint8)
    top, left = (shape[0] - height) // 2, (shape[1] - width) // 2
    canvas[top : top + height, left : left + width] = cv2.resize(picture, (width, height), interpolation=cv2.INTER_AREA)
    return canvas


def count_frames(path: Path) -> int:
    """The number of frames of a video file according to its header; 0 if it cannot be read."""
    if not path.exists():
        return 0
    with path_for_native_code(path) as name:
        video = cv2.VideoCapture(name)
        try:
            return int(video.get(cv2.CAP_PROP_FRAME_COUNT)) if video.isOpened() else 0
        finally:
            video.release()
