"""The sampled values of the golden example: which elements of a tensor it holds, and how they are compared."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .bundle.golden_record import MAX_VALUES, WHOLE_TENSORS, ExpectedTensor
from .parity.tensor_error import box_difference

_DIGITS = 7  # significant digits of a stored number, which float32 has


@dataclass(frozen=True)
class ValueDifference:
    """The first value of a tensor that differs.

    index: of the element, by axis. expected, found: its values.
    differing, compared: numbers of values that differ, and that were compared.
    """

    index: tuple[int, ...]
    expected: float
    found: float
    differing: int
    compared: int


def sampling_step(name: str, shape: tuple[int, ...]) -> int:
    """Return the step between sampled elements: 1 for tensors that are stored whole.

    Otherwise it is the smallest step that gives at most `MAX_VALUES` values and has no common divisor with the size of
    any axis. With a common divisor, some indices of that axis would never be sampled.
    """
    if name in WHOLE_TENSORS:
        return 1
    step = max(1, math.ceil(math.prod(shape) / MAX_VALUES))
    while any(math.gcd(step, size) > 1 for size in shape):
        step += 1
    return step


def sample(name: str, tensor: NDArray, tolerance: float, undefined: NDArray[np.bool_] | None = None) -> ExpectedTensor:
    """Return the expected values of a tensor.

    tolerance: largest accepted difference of a value.
    undefined: of the tensor's shape; true for elements that engines may leave undefined.
    """
    step = sampling_step(name, tensor.shape)
    values: list[float | None] = [_rounded(value) for value in tensor.ravel()[::step].tolist()]
    if undefined is not None:
        skipped = np.broadcast_to(undefined, tensor.shape).ravel()[::step]
        values = [None if skip else value for skip, value in zip(skipped, values, strict=True)]
    return ExpectedTensor.model_validate(
        {
            "shape": tensor.shape,
            "dtype": tensor.dtype.name,
            "step": step,
            "compare": "each",
            "tolerance": _rounded(tolerance, 3),
            "values": tuple(values),
        }
    )


def first_difference(name: str, expected: ExpectedTensor, found: NDArray) -> ValueDifference | None:
    """Compare a tensor of the expected shape with its expected values. Yaws are compared modulo a full turn."""
    numbers = np.array([np.nan if value is None else value for value in expected.values], np.float64)
    is_compared = ~np.isnan(numbers)
    values = found.ravel()[:: expected.step].astype(np.float64)
    difference = values - numbers
    if name == "decoder.boxes":
        difference = box_difference(values.reshape(found.shape), numbers.reshape(found.shape)).ravel()
    # `not <=` instead of `>`, so that a NaN differs.
    differs = ~(np.abs(difference) <= expected.tolerance) & is_compared
    if expected.compare == "rms" and rms(difference[is_compared]) <= expected.tolerance:
        return None
    if not differs.any():
        return None
    first = int(np.argmax(differs))
    index = tuple(int(i) for i in np.unravel_index(first * expected.step, found.shape))
    return ValueDifference(index, numbers[first], values[first], int(differs.sum()), int(is_compared.sum()))


def rms(values: NDArray) -> float:
    """Return the root mean square; 0 for no values."""
    return float(np.sqrt(np.square(values, dtype=np.float64).mean())) if values.size else 0.0


def _rounded(value: float, digits: int = _DIGITS) -> float:
    return float(f"{value:.{digits}g}") if isinstance(value, float) else int(value)
