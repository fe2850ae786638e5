"""The standard deviation and the colour order are folded into the first convolution."""

from typing import cast

import torch
from torch import Tensor, nn

from ...model import DuoSpaceNet


def fold_normalisation(model: DuoSpaceNet) -> None:
    """Divide the first convolution's weights by the standard deviation, and order its input channels as the images are.

    Only the mean remains to be subtracted. It cannot be folded: the convolution pads with zeros, which must remain
    zeros of normalised images.
    """
    encoder = model.image_encoder
    first, normalisation = encoder.first_convolution, encoder.normalisation
    weight = first.weight.double() / normalisation.std.double()[:, None, None]
    mean = cast("Tensor", normalisation.mean)
    if normalisation.flip_colours:
        weight, mean = weight.flip(1), mean.flip(0)
    first.weight = nn.Parameter(weight.float(), requires_grad=False)
    encoder.normalisation = MeanSubtraction(mean)


class MeanSubtraction(nn.Module):
    """Subtracts the mean of each channel.

    mean (3): BGR.
    """

    mean: Tensor

    def __init__(self, mean: Tensor) -> None:
        super().__init__()
        self.register_buffer("mean", mean[:, None, None].clone(), persistent=False)

    def forward(self, images: Tensor) -> Tensor:
        """Convert images (N, H, W, 3) uint8 BGR to (N, 3, H, W) float."""
        # The permutation comes first, because a byte is a quarter of a float.
        return images.permute(0, 3, 1, 2).to(torch.float32) - self.mean
