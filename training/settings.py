"""Training settings: frozen, validated, and stored with every training."""

from dataclasses import asdict
from typing import Annotated, Any

from pydantic import ConfigDict, Field, TypeAdapter, ValidationInfo, field_validator
from pydantic.dataclasses import dataclass
from pydantic_core import PydanticCustomError

Positive = Annotated[int, Field(gt=0)]
Rate = Annotated[float, Field(gt=0, allow_inf_nan=False)]
Share = Annotated[float, Field(ge=0, le=1)]


@dataclass(frozen=True, config=ConfigDict(extra="forbid"))
class Settings:
    """The settings of one training run. An invalid value raises pydantic's ValidationError.

    A batch is `batch_size` clips. Each step uses the next frame of every clip in the batch, so a batch of clips takes
    `frames_per_clip` steps.

    steps: optimiser steps.
    batch_size: frames per step, each from a different clip.
    frames_per_clip: consecutive frames per clip; a clip of a short scene has fewer.
    learning_rate: the peak learning rate of all parameters except the backbone's.
    backbone_learning_rate: the peak learning rate of the backbone. The paper uses a tenth for a pretrained backbone.
    weight_decay: the weight decay of AdamW.
    warmup_steps: steps of the linear learning-rate warm-up. After it the learning rate falls to zero along a cosine.
    clip_norm: the maximum norm of the gradient; a larger gradient is scaled down to it.
    grid_mask: the probability of GridMask at the last step; it grows linearly from 0.
    auxiliary_matches: queries matched to each object in all decoder layers but the last; the last layer matches one.
    pretraining: train the image encoder only, with `PVSupervisionHead`.
    denoising: denoising query groups per frame (0 = off).
    pv_supervision: train `PVSupervisionHead` on the PV features beside the model.
    bev_supervision: train `BEVSupervisionHead` on the BEV features beside the model.
    bf16: compute convolutions in bfloat16.
    seed: the seed of the initial weights, the heads, the clips, GridMask and the denoising noise; 0 to 999.
    """

    steps: Positive
    batch_size: Positive = 2
    frames_per_clip: Positive = 12
    learning_rate: Rate = 2e-4
    backbone_learning_rate: Rate = 2e-4
    weight_decay: Annotated[float, Field(ge=0, allow_inf_nan=False)] = 0.01
    warmup_steps: Annotated[int, Field(ge=0)] = 200
    clip_norm: Rate = 25.0
    grid_mask: Share = 0.0
    auxiliary_matches: Positive = 1
    pretraining: bool = False
    denoising: Annotated[int, Field(ge=0)] = 1
    pv_supervision: bool = True
    bev_supervision: bool = True
    bf16: bool = True
    seed: Annotated[int, Field(ge=0, lt=1000)] = 0

    @field_validator("pv_supervision")
    @classmethod
    def _pretraining_needs_pv_supervision(cls, pv_supervision: bool, earlier: ValidationInfo) -> bool:
        if earlier.data.get("pretraining") and not pv_supervision:
            raise PydanticCustomError("pv_supervision", "expected True with pretraining, which has no other loss")
        return pv_supervision

    def to_dict(self) -> dict[str, Any]:
        """The settings as plain JSON values."""
        return asdict(self)

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> "Settings":
        """The inverse of `to_dict`. Raises ValueError for a field that is missing, unknown or of the wrong type."""
        return TypeAdapter(cls).validate_python(values)
