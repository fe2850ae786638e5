"""Liveness of a quantized graph: its dequantized form must respond to a disturbed element as eager mode does.

The rounded weights change every output by a few per cent, more than many single elements do. The responses do not have
this problem: they are the differences to the outputs without the disturbance, on each side.
"""

from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

Outputs = dict[str, NDArray]
Run = Callable[[Mapping[str, Tensor]], Outputs]

# Largest error of a response, relative to the response. A graph that ignores the element has 1, and one that reads
# another element has about 1.4. The trained nano and a random tiny have at most 0.2.
RESPONSE_TOLERANCE = 0.5
# Of an output that does not depend on the element: its largest response relative to the output.
NO_RESPONSE_TOLERANCE = 1e-4


class Responses:
    """Compares the responses of a graph's dequantized form with those of eager mode."""

    def __init__(self, inputs: Mapping[str, Tensor], reference: Run, dequantized: Run) -> None:
        """inputs: without a disturbance. reference, dequantized: run the graph on each side."""
        self._reference, self._dequantized = reference, dequantized
        self._expected, self._actual = reference(inputs), dequantized(inputs)

    def are_equal(self, disturbed: Mapping[str, Tensor]) -> bool:
        """Whether every output responds to the disturbance in the same way on both sides."""
        expected, actual = self._reference(disturbed), self._dequantized(disturbed)
        return all(self._error(name, expected[name], actual[name]) <= RESPONSE_TOLERANCE for name in self._expected)

    def _error(self, name: str, expected: NDArray, actual: NDArray) -> float:
        """The error of one output's response, relative to the response."""
        response = actual.astype(np.float64) - self._actual[name]
        expected_response = expected.astype(np.float64) - self._expected[name]
        size, scale = np.linalg.norm(expected_response), np.linalg.norm(self._expected[name])
        if size <= NO_RESPONSE_TOLERANCE * scale:
            return 0.0 if np.linalg.norm(response) <= 10 * NO_RESPONSE_TOLERANCE * scale else np.inf
        error = float(np.linalg.norm(response - expected_response) / size)
        return error if np.isfinite(error) else np.inf
