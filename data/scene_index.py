"""The index of `scene.json`: where each frame is in the file, and what is asked about all frames at once.

It is made in one pass over the file, which decodes every frame and keeps none.
"""

from array import array
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import NamedTuple

import msgspec
import numpy as np
from msgspec import UNSET, Raw

from ..runtime.garbage_collection import garbage_collection_paused
from ..runtime.printable import has_control_character
from .scene_fast_check import FastCheck, Suspects
from .scene_records import CameraInFrame, FrameInScene, SceneHeader, value_or


class SceneWithRawFrames(SceneHeader, frozen=True, gc=False, kw_only=True):
    """The whole file; each frame is its text."""

    frames: list[Raw]


@dataclass
class SceneIndex:
    """What is known of all frames.

    header: the fields of the scene.
    starts, sizes: position and number of bytes of each frame in the file. Empty if the frames are kept in memory.
    scene_names: of consecutive frames of one scene. scenes: number of each frame's name in it.
    has_boxes, has_maps: 0 or 1 for each frame.
    box_names: number of boxes by annotated name.
    suspects: the first frames whose numbers, times or paths may be wrong.
    tokens: of each frame; None in a copy in another process.
    """

    header: SceneHeader
    starts: array = field(default_factory=lambda: array("q"))
    sizes: array = field(default_factory=lambda: array("i"))
    scenes: array = field(default_factory=lambda: array("i"))
    scene_names: list[str] = field(default_factory=list)
    has_boxes: bytearray = field(default_factory=bytearray)
    has_maps: bytearray = field(default_factory=bytearray)
    box_names: Counter[str] = field(default_factory=Counter)
    suspects: Suspects = field(default_factory=Suspects)
    tokens: list[str] | None = field(default_factory=list)

    def add_frames(self, frames: Iterable[FrameInScene]) -> None:
        """Add all frames of the file."""
        check = FastCheck(self.header)
        for frame in frames:
            check.add(frame)
            self._add(frame)
        self.suspects = check.suspects()

    def scene_name(self, number: int) -> str:
        """Return the scene of a frame, counted from 0."""
        return self.scene_names[self.scenes[number]]

    def _add(self, frame: FrameInScene) -> None:
        name = value_or(frame.scene, self.header.scene)
        if not self.scene_names or self.scene_names[-1] != name:
            self.scene_names.append(name)
        self.scenes.append(len(self.scene_names) - 1)
        boxes, maps = frame.boxes, frame.maps
        self.has_boxes.append(boxes is not None and boxes is not UNSET)
        self.has_maps.append(maps is not UNSET and len(maps) > 0)
        self.box_names.update([box.name for box in value_or(boxes, ())])
        assert self.tokens is not None
        self.tokens.append(value_or(frame.token, ""))


def index_content(content: bytes) -> SceneIndex | None:
    """Return the index of the content of a file, or None if the content may not be valid.

    It is only an index of what `scene_schema.py` accepts too.
    """
    try:
        scene = msgspec.json.decode(content, type=SceneWithRawFrames)
        index = SceneIndex(SceneHeader(scene.schema_version, scene.scene, scene.cameras, scene.class_mapping))
        if not scene.frames or _has_escaped_colon(content):
            return None
        with garbage_collection_paused():
            index.add_frames(_decode_frames(scene.frames))
    except (msgspec.MsgspecError, UnicodeError, _SuspectError):
        return None
    _add_positions(index, content, scene.frames)
    rest = content[: index.starts[0]] + content[index.starts[-1] + index.sizes[-1] :]
    return index if _is_unambiguous(rest, _keys_of_header(index.header)) else None


def decode_frame(text: bytes | Raw) -> FrameInScene:
    """Decode one frame. Raises msgspec.MsgspecError or UnicodeError."""
    return _DECODER.decode(text)


_DECODER = msgspec.json.Decoder(FrameInScene)


class _SuspectError(Exception):
    """A frame may have a key twice, or a text that is refused."""


def _decode_frames(raws: Iterable[Raw]) -> Iterator[FrameInScene]:
    for raw in raws:
        frame = decode_frame(raw)
        if not _is_unambiguous(bytes(raw), _keys_of_frame(frame)):
            raise _SuspectError
        yield frame


def _add_positions(index: SceneIndex, content: bytes, raws: Iterable[Raw]) -> None:
    """Add where each frame is. A Raw is a view of the content, so its address gives its position."""
    base = np.frombuffer(content, np.uint8).ctypes.data
    for raw in raws:
        view = np.frombuffer(raw, np.uint8)
        index.starts.append(view.ctypes.data - base)
        index.sizes.append(len(view))


def _has_escaped_colon(content: bytes) -> bool:
    """Whether a text in the file may have a colon that is not written as one."""
    return b"\\" in content and (b"\\u003a" in content or b"\\u003A" in content)


class _Keys(NamedTuple):
    """The number of keys in an object, and all texts in it."""

    number: int
    texts: list[str | None]


def _is_unambiguous(text: bytes, keys: _Keys) -> bool:
    """Whether no key occurs twice and no text has control characters.

    A decoder keeps one of two equal keys, so the text of the file has more colons than what was decoded.
    """
    joined = "".join(text for text in keys.texts if text)
    if not joined.isprintable() and has_control_character(joined):
        return False
    return text.count(b":") == keys.number + joined.count(":")


def _keys_of_frame(frame: FrameInScene) -> _Keys:
    cameras, boxes, maps = frame.cameras, value_or(frame.boxes, ()), value_or(frame.maps, {})
    attributes = [box.attribute for box in boxes]
    absent = (frame.token, frame.scene, frame.boxes, frame.maps).count(UNSET)
    absent += attributes.count(UNSET) + [box.num_points for box in boxes].count(UNSET)
    number = 7 + 7 * len(boxes) + len(maps) + sum(map(_num_camera_keys, cameras.values())) - absent
    texts: list[str | None] = [value_or(frame.token, ""), value_or(frame.scene, ""), *cameras, *maps, *maps.values()]
    texts += [camera.image for camera in cameras.values()]
    texts += [box.name for box in boxes]
    texts += [attribute for attribute in attributes if attribute is not UNSET]
    return _Keys(number, texts)


def _num_camera_keys(camera: CameraInFrame) -> int:
    """Count the key of a camera and those in its object."""
    return 6 - (camera.width_px, camera.height_px, camera.intrinsics_px, camera.camera_T_ego).count(UNSET)


def _keys_of_header(header: SceneHeader) -> _Keys:
    """Count the keys of the scene, with that of `frames`."""
    cameras, mapping = value_or(header.cameras, {}), value_or(header.class_mapping, {})
    number = 3 + (header.cameras is not UNSET) + (header.class_mapping is not UNSET)
    number += 5 * len(cameras) + len(mapping)
    return _Keys(number, [header.scene, *cameras, *mapping, *mapping.values()])
