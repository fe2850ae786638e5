"""Rewrites of a model before it is traced: less arithmetic in the graphs, with equal results.

Each rewrite swaps modules of a copy of the model. The parity check compares the graphs with the model itself, so it
proves the rewrites as well.
"""

import copy

from ...model import DuoSpaceNet
from .first_layer import fold_first_self_attention
from .height_slices import slice_heights
from .normalisation import fold_normalisation
from .output_projection import fold_output_projections


def rewrite(model: DuoSpaceNet) -> DuoSpaceNet:
    """A copy of `model`, in evaluation mode, that computes the same with fewer operations."""
    rewritten = copy.deepcopy(model).eval().requires_grad_(False)
    fold_normalisation(rewritten)
    slice_heights(rewritten)
    fold_output_projections(rewritten)
    fold_first_self_attention(rewritten)
    return rewritten


def is_sum(tensor: str) -> bool:
    """Whether the tensor with this name in a rewritten model is a sum of products.

    Another CPU may add in another order, so that the last bit differs.
    """
    return tensor == "queries.content" or (".cross_attention." in tensor and ".deformable.output." in tensor)
