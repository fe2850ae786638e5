"""The focal loss (Lin et al., 2017) for class scores and map masks."""

import torch.nn.functional as F
from torch import Tensor

ALPHA = 0.25
GAMMA = 2.0


def focal_loss(logits: Tensor, targets: Tensor, alpha: float = ALPHA, gamma: float = GAMMA) -> Tensor:
    """The focal loss of each element, -α_t (1 - p_t)^γ log p_t.

    logits: any shape.
    targets: 0 or 1, of the same shape.

    Returns the losses, of the same shape.
    """
    score = logits.sigmoid()
    cross_entropy = F.binary_cross_entropy_with_logits(logits, targets, reduction="none")
    error = score * (1 - targets) + (1 - score) * targets  # 1 - p_t
    weight = alpha * targets + (1 - alpha) * (1 - targets)
    return weight * error**gamma * cross_entropy
