"""The error of one tensor of a bundle against its reference."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class TensorError:
    """The error of a tensor against its reference.

    absolute: largest absolute difference, in the unit of the tensor.
    relative: `absolute` divided by the RMS of the reference.
    cosine: cosine similarity of the two tensors as vectors.
    frame: index of the frame; None on random inputs.
    seed: of the random inputs; None on a frame.
    rms: RMS of the difference divided by the RMS of the reference.
    quantized: whether a quantized graph computed the tensor. Then `rms` counts, otherwise `relative`.

    A NaN or an infinity on either side makes `absolute`, `relative` and `rms` infinite.
    """

    absolute: float
    relative: float
    cosine: float
    frame: int | None = 0
    seed: int | None = None
    rms: float = np.inf
    quantized: bool = False

    @property
    def case(self) -> str:
        """The inputs that gave the error, in words."""
        return f"frame {self.frame}" if self.seed is None else f"random input {self.seed}"

    @classmethod
    def between(cls, actual: NDArray, expected: NDArray, frame: int | None = 0) -> "TensorError":
        """Compare two tensors. Different shapes count as an infinite error."""
        if actual.shape != expected.shape or not (np.isfinite(actual).all() and np.isfinite(expected).all()):
            return cls(np.inf, np.inf, -1.0, frame)
        a, e = actual.astype(np.float64).ravel(), expected.astype(np.float64).ravel()
        absolute = float(np.abs(a - e).max())
        norm = float(np.linalg.norm(e))
        rms, norms = norm / float(np.sqrt(e.size)), float(np.linalg.norm(a)) * norm
        cosine = float(a @ e) / norms if norms else float(absolute == 0)
        if not rms:
            exact = 0.0 if absolute == 0 else np.inf
            return cls(absolute, exact, cosine, frame, rms=exact)
        return cls(absolute, absolute / rms, cosine, frame, rms=float(np.linalg.norm(a - e)) / norm)

    @classmethod
    def between_outputs(
        cls,
        name: str,
        actual: NDArray,
        expected: NDArray,
        frame: int | None = 0,
        heading: NDArray | None = None,
    ) -> "TensorError":
        """Compare two tensors of a graph by the rule for `name`: "boxes" column by column, others as a whole.

        heading: for "boxes", see `box_difference`.
        """
        if name == "boxes":
            return cls.between_boxes(actual, expected, frame, heading)
        return cls.between(actual, expected, frame)

    @classmethod
    def between_boxes(
        cls, actual: NDArray, expected: NDArray, frame: int | None = 0, heading: NDArray | None = None
    ) -> "TensorError":
        """Compare boxes (Q, 9) column by column, each relative to its own RMS; returns the worst column.

        With one RMS for all columns, positions of 40 m would hide a yaw error of 0.01 rad.
        """
        difference = box_difference(actual, expected, heading)
        return cls.worst([cls.between(e + d, e, frame) for d, e in zip(difference.T, expected.T, strict=True)])

    @classmethod
    def worst(cls, errors: list["TensorError"]) -> "TensorError":
        """The error with the largest relative error."""
        return max(errors, key=lambda error: error.relative)


def box_difference(actual: NDArray, expected: NDArray, heading: NDArray | None = None) -> NDArray[np.float64]:
    """Differences (D, 9) between two sets of boxes (D, 9), with the yaw difference in [-π, π).

    expected: can also be one box (9,).
    heading: the lengths (D) of the vectors (sin θ, cos θ) that the yaws come from. The yaw difference of a vector
        shorter than 1 is multiplied by its length. It is then the difference of the vectors across their direction:
        rounding that moves a vector of length 0.01 by 1e-6 turns it by 1e-4 rad.
    """
    difference = actual.astype(np.float64) - expected
    difference[:, 6] = (difference[:, 6] + np.pi) % (2 * np.pi) - np.pi
    if heading is not None:
        difference[:, 6] *= np.minimum(heading, 1)
    return difference
