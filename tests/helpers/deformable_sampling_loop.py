"""Deformable sampling as a loop over its equation in float64, and random inputs for it."""

from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from tests.helpers.references import bilinear

Size = tuple[int, int]


class SamplingInputs(NamedTuple):
    """The arguments of `deformable_sampling`, in its order."""

    values: list[Tensor]
    locations: Tensor
    visible: Tensor
    offsets: Tensor | None
    weights: Tensor | None
    num_heads: int

    def to(self, dtype: torch.dtype) -> "SamplingInputs":
        """The same inputs with numbers of this dtype."""
        offsets, weights = (None if each is None else each.to(dtype) for each in (self.offsets, self.weights))
        values, locations = [each.to(dtype) for each in self.values], self.locations.to(dtype)
        return self._replace(values=values, locations=locations, offsets=offsets, weights=weights)

    def tensors(self) -> dict[str, Tensor]:
        """The tensors by name, without those that are None."""
        named = {"locations": self.locations, "visible": self.visible, "offsets": self.offsets, "weights": self.weights}
        values = {f"value_{i}": value for i, value in enumerate(self.values)}
        return {name: tensor for name, tensor in (named | values).items() if tensor is not None}

    def with_tensors(self, tensors: dict[str, Tensor]) -> "SamplingInputs":
        """The same inputs with other tensors, given as `tensors` returns them."""
        values = [tensors[f"value_{i}"] for i in range(len(self.values))]
        names = ("locations", "visible", "offsets", "weights")
        return self._replace(values=values, **{name: tensors.get(name) for name in names})


def random_inputs(
    sizes: list[Size],
    num_frames: int = 1,
    num_cameras: int = 3,
    num_queries: int = 7,
    num_heads: int = 1,
    num_points: int = 1,
    has_offsets: bool = True,
    has_weights: bool = True,
    seed: int = 0,
) -> SamplingInputs:
    """Random float64 inputs with three channels per head. Half of the locations are visible.

    sizes: rows and columns of a camera's image on each level. The offsets are of the same order, so that many
        samples leave the image on every side.
    """
    rng = np.random.default_rng(seed)
    largest = max(max(size) for size in sizes)
    shape = num_frames, num_queries, num_heads, len(sizes), num_points
    values = [
        torch.tensor(rng.normal(size=(num_cameras, 3 * num_heads, *size))) for _ in range(num_frames) for size in sizes
    ]
    offsets = torch.tensor(rng.normal(0, largest / 2, (*shape, 2))) if has_offsets else None
    weights = torch.tensor(rng.uniform(-1, 1, shape)) if has_weights else None
    locations = torch.tensor(rng.uniform(0, 1, (num_frames, num_cameras, 2, num_queries)))
    visible = torch.tensor(rng.uniform(size=(num_frames, num_cameras, num_queries)) < 0.5)
    return SamplingInputs(values, locations, visible, offsets, weights, num_heads)


def sample_by_loop(inputs: SamplingInputs) -> np.ndarray:
    """Σ_cameras Σ_levels Σ_points w · v(location + offset), over the cameras in which a location is visible."""
    arrays = [None if each is None else each.double().numpy() for each in inputs[1:5]]
    locations, visible, offsets, weights = arrays
    assert locations is not None and visible is not None
    num_frames, _, num_queries = visible.shape
    num_levels, channels = len(inputs.values) // num_frames, inputs.values[0].shape[1]
    num_points = 1 if offsets is None else offsets.shape[4]
    heads = np.split(np.arange(channels), inputs.num_heads)
    images = [value.double().numpy().transpose(0, 2, 3, 1) for value in inputs.values]
    result = np.zeros((num_frames, channels, num_queries))
    for t, n, q in np.argwhere(visible):
        for j, h, p in np.ndindex(num_levels, inputs.num_heads, num_points):
            image = images[t * num_levels + j][n][..., heads[h]]
            x, y = locations[t, n, :, q] * (image.shape[1], image.shape[0])
            dx, dy = (0, 0) if offsets is None else offsets[t, q, h, j, p]
            weight = 1 if weights is None else weights[t, q, h, j, p]
            result[t, heads[h], q] += weight * bilinear(image, x + dx, y + dy)
    return result
