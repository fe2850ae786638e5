"""Differences between the inputs that a stream passes to its graphs and the inputs in eager mode."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...runtime.bundle.manifest import slot_name
from ...runtime.parity.tensor_error import TensorError
from ...runtime.recording_session import RecordingSession
from ..parity.comparison import arrays
from ..parity.reference import GraphRun
from .camera_parts import without_lost_cameras

# Relative to the RMS. Larger than the tolerance of one graph, because errors of two graphs add up in cached values.
INPUT_TOLERANCE = 1e-3

# The leading dimensions of the inputs that have one part per camera or slot. The decoder's inputs hold a whole window.
_AXES = {"images": ("camera",), "image_T_ego": ("camera",), "camera_valid": ("camera",)}
_DECODER_AXES = {
    "image_T_ego": ("slot", "camera"),
    "camera_valid": ("slot", "camera"),
    "past_T_now": ("slot",),
    "time_delta_s": ("slot",),
    "frame_valid": ("slot",),
}


@dataclass(frozen=True)
class InputDifference:
    """A slice of a graph's input that differs from eager mode.

    name: the input and the slice, for example `image_T_ego[slot 1, camera 2 CAM_BACK]`.
    error: the error of the slice.
    remark: a sentence that identifies the wrong value, such as "all its values are 0"; empty if it is unknown.
    """

    graph: str
    name: str
    error: TensorError
    remark: str


def input_differences(
    recordings: Mapping[str, RecordingSession], runs: Mapping[str, GraphRun], cameras: Sequence[str], frame: int
) -> list[InputDifference]:
    """The differences between the stream's inputs and eager mode's, graph by graph in the order in which they run.

    Within a graph, boolean inputs come first, because a wrong mask explains other differences.
    Cached values and poses of masked slots are not compared.

    recordings: the stream's inputs, by graph.
    runs: eager mode's inputs, by graph.
    cameras: camera names, in order.
    frame: index of the frame.
    """
    return [
        difference
        for graph in ("projector", "backbone", "lifter", "segmenter", "decoder")
        if graph in runs
        for difference in _graph_differences(graph, *_compared(graph, recordings, runs), cameras, frame)
    ]


def _compared(
    graph: str, recordings: Mapping[str, RecordingSession], runs: Mapping[str, GraphRun]
) -> tuple[dict[str, NDArray], dict[str, NDArray]]:
    """The stream's inputs of a graph and eager mode's, both without the features of lost cameras."""
    actual, expected = recordings[graph].inputs, arrays(runs[graph].inputs)
    camera_valid = runs["projector" if graph == "lifter" else graph].inputs.get("camera_valid")
    if camera_valid is None:
        return actual, expected
    return without_lost_cameras(actual, camera_valid.numpy()), without_lost_cameras(expected, camera_valid.numpy())


def _graph_differences(
    graph: str,
    actual: Mapping[str, NDArray],
    expected: Mapping[str, NDArray],
    cameras: Sequence[str],
    frame: int,
) -> Iterator[InputDifference]:
    for name in sorted(expected.keys() & actual.keys(), key=lambda name: _order(name, expected)):
        axes = _axes(graph, name)
        for index in np.ndindex(*expected[name].shape[: len(axes)]):
            part = InputSlice(name, index, axes)
            error = TensorError.between(part.of(actual), part.of(expected), frame)
            if not error.relative <= INPUT_TOLERANCE and not part.is_masked(expected):
                yield InputDifference(graph, part.label(cameras), error, _explain(part, actual, expected))


def _order(name: str, expected: Mapping[str, NDArray]) -> tuple[bool, int]:
    return expected[name].dtype != np.bool_, list(expected).index(name)


def _axes(graph: str, name: str) -> tuple[str, ...]:
    return _DECODER_AXES.get(name, ()) if graph == "decoder" else _AXES.get(name, ())


@dataclass(frozen=True)
class InputSlice:
    """The part of an input that belongs to one camera or one slot, or the whole input if it has no such axes.

    name: name of the input.
    index: index along each of `axes`.
    axes: "slot" or "camera", for each leading dimension.
    """

    name: str
    index: tuple[int, ...]
    axes: tuple[str, ...]

    def of(self, inputs: Mapping[str, NDArray]) -> NDArray:
        """The values of this slice."""
        return inputs[self.name][self.index]

    @property
    def slot(self) -> int | None:
        """The slot of the window that the slice belongs to."""
        if self.name.startswith("slot"):
            return int(self.name.removeprefix("slot").split(".")[0])
        return self.index[0] if self.axes[:1] == ("slot",) else None

    def is_masked(self, expected: Mapping[str, NDArray]) -> bool:
        """Whether the slice belongs to a slot that must be empty, so that its values do not matter."""
        return self.slot is not None and self.name != "frame_valid" and not expected["frame_valid"][self.slot]

    def label(self, cameras: Sequence[str]) -> str:
        """A name for messages, for example `image_T_ego[slot 1, camera 2 CAM_BACK]`."""
        labels = [f"{axis} {i}" for axis, i in zip(self.axes, self.index, strict=True)]
        if self.axes[-1:] == ("camera",) and self.index[-1] < len(cameras):
            labels[-1] += f" {cameras[self.index[-1]]}"
        return f"{self.name}[{', '.join(labels)}]" if labels else self.name

    def siblings(self, expected: Mapping[str, NDArray]) -> Iterator["InputSlice"]:
        """Slices of the same input for other cameras or slots. A faulty pipeline may pass one of them instead."""
        if self.name.startswith("slot"):
            cached_name = self.name.split(".", 1)[1]
            for slot in range(len(expected["frame_valid"])):
                yield InputSlice(slot_name(slot, cached_name), (), ())
        for axis in range(len(self.axes)):
            for i in range(expected[self.name].shape[axis]):
                yield InputSlice(self.name, (*self.index[:axis], i, *self.index[axis + 1 :]), self.axes)


def _explain(part: InputSlice, actual: Mapping[str, NDArray], expected: Mapping[str, NDArray]) -> str:
    """A sentence that identifies the wrong value of `part`; empty if it is unknown."""
    wrong, right = part.of(actual), part.of(expected)
    for change, changed in _typical_mistakes(wrong, right).items():
        if _is_close(wrong, changed):
            return f"it is the {change} of the expected value"
    for sibling in part.siblings(expected):
        if wrong.ndim and sibling != part and _is_close(wrong, sibling.of(expected)):
            return f"it is the expected value of {sibling.label(())}"
    return "" if wrong.any() else "all its values are 0"


def _typical_mistakes(wrong: NDArray, right: NDArray) -> dict[str, NDArray]:
    """The values that common mistakes make of the right value, by the name of the change."""
    if wrong.shape == (4, 4):
        return {"inverse": np.linalg.inv(right), "transpose": right.T}
    if wrong.dtype == np.bool_ or not wrong.any():
        return {}
    return {
        "negative": -right.astype(np.float64),
        "mirror image (last dimension reversed)": np.atleast_1d(right)[..., ::-1],
    }


def _is_close(actual: NDArray, expected: NDArray) -> bool:
    return TensorError.between(actual, expected).relative <= INPUT_TOLERANCE
