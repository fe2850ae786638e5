"""What a stream gives its graphs to eat, beside what eager mode gives the same graphs."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import cast

import numpy as np
import onnxruntime as ort
from numpy.typing import NDArray

from ...runtime import Frame, Pipeline
from ...runtime.bundle.manifest import slot_name
from ...runtime.session import Session, Tensors
from ..parity.comparison import TensorError
from ..parity.reference import Run

FEED_TOLERANCE = 1e-3  # of a value relative to its RMS; what lies in memory has been through two graphs

# What an input's leading dimensions count; the decoder's have the frame of the window in front.
_AXES = {"images": ("camera",), "image_T_ego": ("camera",), "camera_valid": ("camera",)}
_WINDOW_AXES = {
    "image_T_ego": ("slot", "camera"),
    "camera_valid": ("slot", "camera"),
    "past_T_now": ("slot",),
    "time_delta_s": ("slot",),
    "frame_valid": ("slot",),
}


@dataclass(frozen=True)
class InputDifference:
    """A part of a graph's input that is not what eager mode feeds. remark: what it is instead, where that is known."""

    graph: str
    name: str
    error: TensorError
    remark: str


class RecordedInputs:
    """One session's shadow: passes on what it is fed, and keeps it, and what it answers, by name."""

    def __init__(self, session: Session) -> None:
        self._session = session
        self.inputs: dict[str, NDArray] = {}
        self.outputs: dict[str, NDArray] = {}

    def run(self, tensors: Mapping[str, ort.OrtValue]) -> Tensors:
        outputs = self._session.run(tensors)
        self.inputs = {name: value.numpy().copy() for name, value in tensors.items()}
        self.outputs = {name: value.numpy().copy() for name, value in outputs.items()}
        return outputs


def record(pipeline: Pipeline, frames: Sequence[Frame]) -> dict[str, RecordedInputs]:
    """Drive a new stream over `frames` and keep what each graph was fed last. A graph that rests keeps nothing."""
    recordings = {name: RecordedInputs(session) for name, session in pipeline.sessions.items()}
    shadowed = Pipeline(pipeline.manifest, cast("dict[str, Session]", recordings))
    stream = shadowed.stream(maps="segmenter" in recordings)
    for frame in frames:
        for recording in recordings.values():
            recording.inputs, recording.outputs = {}, {}
        stream.step(frame)
    return recordings


def input_differences(
    recordings: Mapping[str, RecordedInputs], runs: Mapping[str, Run], cameras: Sequence[str], frame: int
) -> list[InputDifference]:
    """Where the stream fed something else than eager mode did, graph by graph in the order of a frame.

    Flags come first in a graph, for they explain the rest; what lies in slots that are masked does not count.
    cameras: their names, in order.
    """
    return [
        difference
        for graph in ("projector", "backbone", "lifter", "segmenter", "decoder")
        if graph in runs
        for difference in _in_graph(graph, recordings[graph].inputs, runs[graph], cameras, frame)
    ]


def _in_graph(
    graph: str, fed: Mapping[str, NDArray], run: Run, cameras: Sequence[str], frame: int
) -> Iterator[InputDifference]:
    expected = {name: value.numpy() for name, value in run.inputs.items()}
    for name in sorted(expected.keys() & fed.keys(), key=lambda name: _order(name, expected)):
        axes = _axes(graph, name)
        for index in np.ndindex(*expected[name].shape[: len(axes)]):
            part = Part(name, index, axes)
            error = TensorError.between(part.of(fed), part.of(expected), frame)
            if not error.relative <= FEED_TOLERANCE and not part.is_masked(expected):
                yield InputDifference(graph, part.label(cameras), error, _remark(part, fed, expected))


def _order(name: str, expected: Mapping[str, NDArray]) -> tuple[bool, int]:
    return expected[name].dtype != np.bool_, list(expected).index(name)


def _axes(graph: str, name: str) -> tuple[str, ...]:
    return _WINDOW_AXES.get(name, ()) if graph == "decoder" else _AXES.get(name, ())


@dataclass(frozen=True)
class Part:
    """One camera's or one slot's share of an input; the whole of an input that is not shared out."""

    name: str
    index: tuple[int, ...]
    axes: tuple[str, ...]

    def of(self, values: Mapping[str, NDArray]) -> NDArray:
        return values[self.name][self.index]

    @property
    def slot(self) -> int | None:
        """The frame of the window that it belongs to."""
        if self.name.startswith("slot"):
            return int(self.name.removeprefix("slot").split(".")[0])
        return self.index[0] if self.axes[:1] == ("slot",) else None

    def is_masked(self, expected: Mapping[str, NDArray]) -> bool:
        """Whether it lies in a slot that should hold no frame, so that it may be anything."""
        return self.slot is not None and self.name != "frame_valid" and not expected["frame_valid"][self.slot]

    def label(self, cameras: Sequence[str]) -> str:
        """As in `image_T_ego[slot 1, camera 2 CAM_BACK]`."""
        words = [f"{axis} {i}" for axis, i in zip(self.axes, self.index, strict=True)]
        if self.axes[-1:] == ("camera",) and self.index[-1] < len(cameras):
            words[-1] += f" {cameras[self.index[-1]]}"
        return f"{self.name}[{', '.join(words)}]" if words else self.name

    def siblings(self, expected: Mapping[str, NDArray]) -> Iterator["Part"]:
        """The parts that it could have been taken for: of other cameras, or of other slots."""
        if self.name.startswith("slot"):
            memory = self.name.split(".", 1)[1]
            for slot in range(len(expected["frame_valid"])):
                yield Part(slot_name(slot, memory), (), ())
        for axis in range(len(self.axes)):
            for i in range(expected[self.name].shape[axis]):
                yield Part(self.name, (*self.index[:axis], i, *self.index[axis + 1 :]), self.axes)


def _remark(part: Part, fed: Mapping[str, NDArray], expected: Mapping[str, NDArray]) -> str:
    """What was fed instead, where it is something that can be named."""
    got, right = part.of(fed), part.of(expected)
    if got.shape == (4, 4):
        candidates = {"inverse": np.linalg.inv(right), "transpose": right.T}
    elif got.dtype == np.bool_ or not got.any():
        candidates = {}
    else:
        mirrored = np.atleast_1d(right)[..., ::-1]
        candidates = {"negative": -right.astype(np.float64), "mirror image in its last dimension": mirrored}
    for what, candidate in candidates.items():
        if _close(got, candidate):
            return f"it is the {what} of what was expected"
    for sibling in part.siblings(expected):
        if got.ndim and sibling != part and _close(got, sibling.of(expected)):
            return f"it is what {sibling.label(())} should be"
    return "" if got.any() else "it is zero throughout"


def _close(got: NDArray, candidate: NDArray) -> bool:
    return TensorError.between(got, candidate).relative <= FEED_TOLERANCE
