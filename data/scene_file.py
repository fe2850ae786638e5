"""An open `scene.json`: checked as a whole once, then read frame by frame."""

import hashlib
import os
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec

from ..runtime.errors import InputError
from ..runtime.files import change_stamp, read_regular_file
from ..runtime.json_record import MAX_JSON_BYTES, check_record, parse_json
from .scene_index import SceneIndex, decode_frame, index_content
from .scene_records import Box, Calibration, CameraInFrame, FrameInScene, SceneHeader, value_or
from .scene_schema import SceneRecord


class SceneFile:
    """The records of a `scene.json`. Only an index of the frames stays in memory, and is pickled.

    path: of the file.
    sha256: of its content.
    index: what is known of all frames.
    """

    def __init__(self, path: Path) -> None:
        """Read and check the file. Raises InputError, naming the file and the field."""
        self.path = path
        content = read_regular_file(path, MAX_JSON_BYTES, InputError)
        self.sha256 = hashlib.sha256(content).hexdigest()
        self._stamp = change_stamp(path.stat())
        self._kept: tuple[FrameInScene, ...] | None = None
        self._last: tuple[int, FrameInScene] | None = None
        index = index_content(content)
        if index is None:  # the file is not valid, or is valid but unusual
            header, self._kept = read_strictly(path, content)
            index = SceneIndex(header)
            index.add_frames(self._kept)
        self.index = index

    def __getstate__(self) -> dict[str, Any]:
        return self.__dict__ | {"index": replace(self.index, tokens=None), "_last": None}

    def __len__(self) -> int:
        return len(self.index.scenes)

    @property
    def header(self) -> SceneHeader:
        """The fields of the scene."""
        return self.index.header

    def frame(self, number: int) -> FrameInScene:
        """Return the record of a frame, counted from 0. Raises InputError if the file has changed."""
        if self._kept is not None:
            return self._kept[number]
        last = self._last
        if last is None or last[0] != number:
            last = self._last = (number, self._read(number))
        return last[1]

    def tokens(self) -> Iterator[str]:
        """Return the token of each frame."""
        if self.index.tokens is not None:
            return iter(self.index.tokens)
        return (value_or(self.frame(number).token, "") for number in range(len(self)))

    def _read(self, number: int) -> FrameInScene:
        try:
            with self.path.open("rb") as file:
                if change_stamp(os.fstat(file.fileno())) == self._stamp:
                    file.seek(self.index.starts[number])
                    return decode_frame(file.read(self.index.sizes[number]))
        except (OSError, msgspec.MsgspecError, UnicodeError):
            pass
        raise InputError(
            f"{self.path}: expected the file that was checked at the start; got one that has been changed or removed "
            "since. Start again."
        )


def read_strictly(path: Path, content: bytes) -> tuple[SceneHeader, tuple[FrameInScene, ...]]:
    """Read a file slowly. Raises InputError, naming the file and the first wrong field, if it is not valid."""
    record = check_record(path, parse_json(path, content, InputError), SceneRecord, InputError)
    values = record.model_dump(exclude_unset=True)
    frames = tuple(_to_frame(**frame) for frame in values.pop("frames"))
    if "cameras" in values:
        values["cameras"] = {name: Calibration(**fields) for name, fields in values["cameras"].items()}
    return SceneHeader(**values), frames


def _to_frame(**fields: Any) -> FrameInScene:
    """Return the record of a frame from the checked values of its fields."""
    cameras = {name: CameraInFrame(**camera) for name, camera in fields.pop("cameras").items()}
    if fields.get("boxes") is not None:
        fields["boxes"] = tuple(Box(**box) for box in fields["boxes"])
    return FrameInScene(cameras=cameras, **fields)
