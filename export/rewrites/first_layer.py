"""The self-attention of the first decoder layer is a constant."""

import copy

import torch
from torch import Tensor, nn

from ...model import DuoSpaceNet


@torch.no_grad()
def fold_first_self_attention(model: DuoSpaceNet) -> None:
    """Replace the initial content of the queries by what the first layer's self-attention makes of it.

    The first layer's queries are parameters: no frame changes their content and their pose.
    """
    layer, encoder = model.decoder.layers[0], model.decoder.pose_encoder
    # In float64, other CPUs give the same constant, except for a last bit now and then.
    layer_64, encoder_64 = copy.deepcopy(layer).double(), copy.deepcopy(encoder).double()
    content, pose = (tensor.double() for tensor in model.queries())
    content = layer_64.attend_to_queries(content, encoder_64(pose))
    model.queries.content = nn.Parameter(content.float(), requires_grad=False)
    layer.self_attention, layer.self_attention_norm = NoSelfAttention(), nn.Identity()


class NoSelfAttention(nn.Module):
    """Adds nothing to the content of the queries."""

    def forward(self, z: Tensor) -> Tensor:
        """Return a zero."""
        return z.new_zeros(())
