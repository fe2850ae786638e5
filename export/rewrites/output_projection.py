"""The output projection of attention is folded into the first layer of the temporal recurrence."""

import torch
from torch import Tensor, nn

from ...model import DuoSpaceNet
from ...model.cross_attention import TemporalCrossAttention, TemporalRecurrence


def fold_output_projections(model: DuoSpaceNet) -> None:
    """Let each attention return what the first layer of its recurrence would compute from its output.

    That layer is linear in the state and in the attention's output, so it can be split. Its part for the output and
    the output projection are one matrix.
    """
    for module in model.decoder.modules():
        if isinstance(module, TemporalCrossAttention):
            projection, first = module.attention.deformable.output, module.recurrence.mlp[0]
            weight = first.weight.double()[:, first.in_features // 2 :]
            module.recurrence = SplitRecurrence(module.recurrence)
            module.attention.deformable.output = _linear(
                weight @ projection.weight.double(), weight @ projection.bias.double()
            )


class SplitRecurrence(nn.Module):
    """A temporal recurrence whose first layer takes the state only, and adds its part for the attention's output."""

    def __init__(self, recurrence: TemporalRecurrence) -> None:
        super().__init__()
        first, *others = recurrence.mlp
        self.state = _linear(first.weight[:, : first.in_features // 2], first.bias)
        self.mlp = nn.Sequential(*others)

    def forward(self, attended: Tensor, frame_valid: Tensor) -> Tensor:
        """Aggregate the frames, as `TemporalRecurrence` does.

        attended (T, Q, C): the first layer's part for the output of the attention.
        """
        state: Tensor | None = None
        for t in reversed(range(len(attended))):
            # The initial state is zero.
            first = self.state.bias if state is None else self.state(state)
            updated = self.mlp(attended[t] + first)
            state = torch.where(frame_valid[t], updated, 0.0 if state is None else state)
        assert state is not None
        return state


def _linear(weight: Tensor, bias: Tensor) -> nn.Linear:
    linear = nn.Linear(weight.shape[1], weight.shape[0]).requires_grad_(False)
    linear.weight.copy_(weight)
    linear.bias.copy_(bias)
    return linear
