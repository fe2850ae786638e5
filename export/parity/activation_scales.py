"""The scales of a quantized graph's activations, compared with the numbers that the activations have on frames."""

from collections.abc import Iterator, Mapping

import numpy as np
import onnx
from numpy.typing import NDArray
from onnx import TensorProto, helper

from ...runtime.onnxruntime_session import ensure_thread_pool
from ..bisection.pieces import unoptimised_session
from .dequantized_graph import ActivationScale, DequantizedGraph

# The calibration saw other frames, so the ranges differ: by a factor of 1.4 at most for the trained nano.
LARGEST_RATIO = 4.0


class DequantizedSession:
    """Runs the dequantized form of a graph. It also measures the range of every tensor that the graph rounds."""

    def __init__(self, dequantized: DequantizedGraph) -> None:
        """dequantized: with the Relus."""
        ensure_thread_pool()  # another engine may run the bundle
        self._activations = list(dequantized.activations.values())
        self._outputs = [value.name for value in dequantized.model.graph.output]
        self._session = unoptimised_session(_with_ranges(dequantized).SerializeToString())
        self._shapes = {node.name: tuple(node.shape) for node in self._session.get_inputs()}
        self._ranges: list[tuple[float, float]] = [(np.inf, -np.inf)] * len(self._activations)

    def outputs_for(self, inputs: Mapping[str, NDArray]) -> dict[str, NDArray]:
        """The outputs for `inputs`, by name. Those of several groups of cameras are joined."""
        groups = [self._session.run(self._outputs, group) for group in self._groups(inputs)]
        values = groups[0] if len(groups) == 1 else [np.concatenate(each) for each in zip(*groups, strict=True)]
        return dict(zip(self._outputs, values, strict=True))

    def measure(self, inputs: Mapping[str, NDArray]) -> None:
        """Widen the measured ranges by the numbers on these inputs."""
        names = [name for activation in self._activations for name in _range_names(activation.tensor)]
        for group in self._groups(inputs) if names else ():
            values = self._session.run(names, group)
            pairs = zip(values[::2], values[1::2], strict=True)
            self._ranges = [
                (min(low, float(new_low)), max(high, float(new_high)))
                for (low, high), (new_low, new_high) in zip(self._ranges, pairs, strict=True)
            ]

    def _groups(self, inputs: Mapping[str, NDArray]) -> Iterator[dict[str, NDArray]]:
        """The inputs of each run: a backbone may take fewer cameras than there are."""
        num_together = self._shapes["images"][0] if "images" in self._shapes else 0
        if not num_together or num_together == len(inputs["images"]):
            yield {name: inputs[name] for name in self._shapes}
            return
        for first in range(0, len(inputs["images"]), num_together):
            yield {"images": inputs["images"][first : first + num_together]}

    def scale_failures(self) -> Iterator[str]:
        """The activations whose scale does not fit the measured numbers, one line each."""
        for activation, (low, high) in zip(self._activations, self._ranges, strict=True):
            yield from _scale_failures(activation, low, high)


def _scale_failures(activation: ActivationScale, low: float, high: float) -> Iterator[str]:
    lowest, highest = activation.range
    stored, measured = highest - lowest, max(high, 0.0) - min(low, 0.0)  # every stored range includes 0
    needed = max(highest, high) - min(lowest, low)
    # Zeros alone fit every scale. `not <=` instead of `>`, so that a NaN fails.
    is_zero = low == high == 0
    if not is_zero and not (stored <= LARGEST_RATIO * measured and needed <= LARGEST_RATIO * stored):
        yield (
            f"{activation.tensor}: expected a scale for numbers from {low:.3g} to {high:.3g}, as on the frames; "
            f"got one for {lowest:.3g} to {highest:.3g}"
        )


def _with_ranges(dequantized: DequantizedGraph) -> onnx.ModelProto:
    """The model with the smallest and the largest number of each activation as further outputs."""
    model = onnx.ModelProto()
    model.CopyFrom(dequantized.model)
    for tensor in dequantized.activations:
        for operator, name in zip(("ReduceMin", "ReduceMax"), _range_names(tensor), strict=True):
            model.graph.node.append(helper.make_node(operator, [tensor], [name], keepdims=0))
            model.graph.output.append(helper.make_tensor_value_info(name, TensorProto.FLOAT, []))
    return model


def _range_names(tensor: str) -> tuple[str, str]:
    return f"smallest {tensor}", f"largest {tensor}"
