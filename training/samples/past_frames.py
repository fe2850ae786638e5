"""Past frames of a training sample, at a random stride (paper; Sparse4D, Lin et al., 2022)."""

from dataclasses import dataclass

import numpy as np

_STRIDE_STREAM = 1  # number of the random stream, so that no other use of the same seed gets the same numbers


@dataclass(frozen=True)
class PastFrames:
    """Which past frames belong to a sample.

    A stride counts frames of the source, not seconds. Where a source lacks frames, the past frames of a sample are
    older than elsewhere.

    seed: the seed of the strides.
    number: past frames of a sample, at most; 0 trains on single frames.
    strides: distances between neighbours of a window [frames]. Every sample has one of them, all equally likely.
    """

    seed: int
    number: int
    strides: tuple[int, ...] = (1,)

    def stride(self, sample: int) -> int:
        """The stride of sample `sample`. It depends on the seed and the number of the sample only."""
        rng = np.random.default_rng([self.seed, sample, _STRIDE_STREAM])
        return self.strides[int(rng.integers(len(self.strides)))]

    def window(self, newest: int, first: int, sample: int) -> list[int]:
        """The indices of the frames of a window, the oldest first.

        newest: the index of the frame that is trained.
        first: the index of the first frame that the window may contain: of the scene, or after a reset.
        """
        stride = self.stride(sample)
        past = range(newest - stride, first - 1, -stride)[: self.number]
        return [*reversed(past), newest]
