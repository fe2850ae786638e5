"""The values that a graph may hold for a tensor of the model: unchanged, transposed, or folded with a BatchNorm."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ..rewrites import is_sum
from .used_tensors import Fold, UsedTensors

# The exporter folds a BatchNorm in float32, which rounds three times. A change of 1e-5 is ten times larger.
FOLD_TOLERANCE = 1e-6
SCALE_TOLERANCE = 1e-5  # of half a step of a quantized number


@dataclass(frozen=True)
class StoredForm:
    """One form in which a graph may hold one or more tensors of the model.

    tensors: names of the model's tensors. A graph that holds the values of this form holds all of these tensors.
    usual_name: the name that the exporter gives to these values. Only the order of the search depends on it.
    size: how many numbers.
    compute: returns the numbers, in the order of a graph file, and the largest rounding error of each.
    """

    tensors: tuple[str, ...]
    usual_name: str
    size: int
    compute: Callable[[], tuple[NDArray, NDArray | float]] = field(repr=False)

    def equals(self, stored: NDArray, rounding: NDArray | float = 0.0) -> bool:
        """Whether `stored` holds these numbers, within the rounding error.

        rounding: the largest error of each number of `stored`, if it comes from a quantized graph.
        """
        values, error = self.compute()
        if isinstance(error, float) and isinstance(rounding, float):
            return np.array_equal(stored.ravel(), values.ravel())
        return not self.differences(stored, rounding).any()

    def differences(self, stored: NDArray, rounding: NDArray | float = 0.0) -> NDArray[np.float64]:
        """The difference of each number of `stored`: 0 within the rounding error, infinite for NaN or infinity."""
        values, error = self.compute()
        with np.errstate(invalid="ignore", over="ignore"):
            difference = np.abs(stored.ravel().astype(np.float64) - values.ravel())
        difference[~np.isfinite(difference)] = np.inf
        # The scale of a quantized number is a float32, so half a step of it is not exact.
        return np.where(difference <= np.ravel(error) + np.ravel(rounding) * (1 + SCALE_TOLERANCE), 0.0, difference)


def stored_forms(used: UsedTensors) -> list[StoredForm]:
    """All forms in which a graph may hold the tensors that it uses."""
    arrays = {name: tensor.detach().numpy() for name, tensor in used.tensors.items()}
    unfolded = [form for name, values in arrays.items() for form in _unfolded(name, values)]
    return unfolded + [form for fold in used.folds for form in _folded(fold, arrays)]


def _unfolded(name: str, values: NDArray) -> list[StoredForm]:
    """The tensor itself, and its transpose if it is a matrix: a MatMul needs the transposed weight of a linear layer.

    A graph must hold exactly these numbers, unless they are sums. Its type may be wider, and its shape may be another.
    """

    def compute(matrix: NDArray) -> tuple[NDArray, NDArray | float]:
        return matrix, FOLD_TOLERANCE * np.abs(matrix) if is_sum(name) else 0.0

    forms = [StoredForm((name,), name, values.size, lambda: compute(values))]
    if name.endswith(".locations"):
        # Constant locations (..., 2, Q) become grid_sample coordinates (..., Q, 2) at the export.
        forms.append(StoredForm((name,), name, values.size, lambda: compute((2 * values - 1).swapaxes(-1, -2))))
    if values.ndim == 2:
        forms.append(StoredForm((name,), name, values.size, lambda: compute(values.T)))
    return forms


def _folded(fold: Fold, arrays: Mapping[str, NDArray]) -> list[StoredForm]:
    """The weight and the bias of a convolution that includes its BatchNorm."""
    weight, bias = f"{fold.convolution}.weight", f"{fold.convolution}.bias"
    names = [f"{fold.batch_norm}.{part}" for part in ("weight", "bias", "running_mean", "running_var")]
    gamma, beta, mean, variance = (arrays[name].astype(np.float64) for name in names)
    scale = gamma / np.sqrt(variance + fold.eps)

    def folded_weight() -> tuple[NDArray, NDArray]:
        values = arrays[weight] * scale.reshape(-1, *[1] * (arrays[weight].ndim - 1))
        return values, FOLD_TOLERANCE * np.abs(values)

    def folded_bias() -> tuple[NDArray, NDArray]:
        terms = [beta, -mean * scale] + ([arrays[bias] * scale] if bias in arrays else [])
        return np.sum(terms, axis=0), FOLD_TOLERANCE * np.sum(np.abs(terms), axis=0)

    shifts = (names[1], names[2], *([bias] if bias in arrays else []))
    return [
        StoredForm((weight, names[0], names[3]), weight, arrays[weight].size, folded_weight),
        StoredForm(shifts, f"{weight}_bias", beta.size, folded_bias),
    ]
