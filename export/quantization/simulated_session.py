"""Sessions of quantized graphs in which all arithmetic is float32: what the rounding alone does.

An engine multiplies and adds 8-bit numbers. Some CPUs saturate such sums at 16 bits. So the engine can lose more than
the rounding does, and the two are measured side by side.
"""

from collections.abc import Mapping

import onnxruntime as ort

from ...runtime.session import Tensors
from ...runtime.termination import terminable
from ..bisection.pieces import unoptimised_session


class SimulatedSession:
    """A graph without onnxruntime's optimisations: QuantizeLinear rounds, and every other operator is float32."""

    def __init__(self, graph: bytes) -> None:
        """graph: the content of its file. The process's thread pool must exist, for example by `Pipeline.load`."""
        self._session = unoptimised_session(graph)
        self._inputs = [node.name for node in self._session.get_inputs()]
        self._outputs = [node.name for node in self._session.get_outputs()]

    @property
    def precision(self) -> str:
        """Number format in which float operators are computed."""
        return "float32"

    def run(self, tensors: Mapping[str, ort.OrtValue]) -> Tensors:
        """Run the graph as `Session.run` does."""
        inputs, options = {name: tensors[name] for name in self._inputs}, ort.RunOptions()
        with terminable(lambda: setattr(options, "terminate", True)):
            values = self._session.run_with_ort_values(self._outputs, inputs, options)
        return dict(zip(self._outputs, values, strict=True))
