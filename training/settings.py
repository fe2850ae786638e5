"""Training settings: frozen, validated, and stored with every training."""

from typing import Annotated, Any, Literal

from pydantic import ConfigDict, Field, TypeAdapter, ValidationInfo, field_validator
from pydantic.dataclasses import dataclass
from pydantic_core import PydanticCustomError

from ..runtime.json_record import Flag
from ..weights.trained_parts import Part

# Strict: pydantic would otherwise accept the text "2" or the boolean true as a number.
Positive = Annotated[int, Field(strict=True, gt=0)]
Count = Annotated[int, Field(strict=True, ge=0)]
Rate = Annotated[float, Field(strict=True, gt=0, allow_inf_nan=False)]
Weight = Annotated[float, Field(strict=True, ge=0, allow_inf_nan=False)]
Share = Annotated[float, Field(strict=True, ge=0, le=1)]
ShareBelowOne = Annotated[float, Field(strict=True, ge=0, lt=1)]
PoseWeights = Annotated[tuple[Weight, ...], Field(min_length=10, max_length=10)]


@dataclass(frozen=True, config=ConfigDict(extra="forbid"))
class Settings:
    """The settings of one training run. An invalid value raises pydantic's ValidationError.

    The defaults are the recipe "cpu".

    A batch is `batch_size` clips. Each step uses the next sample of every clip in the batch.

    Length:

    recipe: the name of the recipe that the settings come from, for the record only.
    steps: optimiser steps.
    epochs: passes over the sources. If it is given, the training job computes `steps` from it, as if every step had
        `batch_size` samples. With "stream" and clips of different lengths, some steps have fewer.
    batch_size: samples per step over all processes, each from a different clip.
    seed: the seed of the initial weights, the heads, the clips, GridMask, dropout and the denoising noise; 0 to 999.

    Data:

    tasks: what is trained: "detection", "maps" or "both".
    history: "stream": the frames of a clip are trained one after the other. Past features keep the values of the step
        that trained them. "windows": a sample is one frame with its past frames, whose features are computed with the
        current weights and without gradient.
    history_strides: "windows" only: the distance between two past frames [frames]; a random one for each sample.
    past_frames: the past frames of a sample; None = those of the model's temporal window, 0 = none.
    frames_per_clip: consecutive frames per clip with "stream"; a clip of a short scene has fewer. With "windows", the
        frames of each synthetic scene.
    class_balanced: sample clips with rare classes more often (CBGS, Zhu et al., 2019).
    photometric, geometric: augmentation of the images, see `samples/augmentation.py`.
    grid_mask: the probability of GridMask.
    grid_mask_ramp: let the probability of GridMask grow linearly from 0 at the first step to `grid_mask` at the last.

    Optimisation:

    learning_rate: the peak learning rate of all parameters except the backbone's.
    backbone_learning_rate: the peak learning rate of the backbone.
    weight_decay: the weight decay of AdamW.
    warmup_steps: steps of the linear learning-rate warm-up (0 = off).
    warmup_start: the learning rate at step 0, as a fraction of its value without warm-up.
    final_learning_rate: the learning rate at the end of the cosine schedule, as a fraction of the peak.
    clip_norm: the maximum norm of the gradient; a larger gradient is scaled down to it.
    ema_decay: the decay of the exponential moving average of the weights (0 = off).
    amp: automatic mixed precision: the type in which convolutions compute. The lifter and the decoder use float32.
    frozen_stages: the number of first stages of the backbone that are not trained: 1 = the stem and the first stage.
    backbone_norm_eval: keep the BatchNorm layers of the backbone in evaluation mode, without gradient.
    frozen_parts: parts of the model that are not trained, see `weights.trained_parts`.
    norm_eval: keep all BatchNorm layers in evaluation mode. Outside the frozen parts, their parameters are trained.
    dropout: the dropout rate in attention, FFN and output projections.

    Matching and losses. Pose weights are in the order of pose vectors: x y z, log w l h, sin cos, vx vy.

    match_class_cost, match_box_cost, match_box_weights: the weights of the matching costs.
    auxiliary_matches: queries matched to each object in all decoder layers but the last; the last layer matches one.
    class_weight, box_weight, box_loss_weights: the weights of the detection losses.
    loss_average: the divisor of the detection losses. "frame": the number of matched queries of the frame. "batch": the
        mean number of matched queries per frame of the batch.
    box_loss_min_score: only matched queries with a larger class score have a box loss (0 = all).
    yaw_free_classes: classes whose yaw has weight 0, in the matching and in the loss.
    map_focal_weight, map_dice_weight: the weights of the map losses.

    Initialisation:

    content_init: the distribution of the content embeddings: "normal" (standard deviation 1) or "xavier" (uniform).
    anchor_size: the size of the initial queries: "car", or "mean": the mean size of all boxes (Sparse4D).

    Additions:

    pretraining: train the image encoder only, with `PVSupervisionHead`.
    denoising: denoising query groups per frame (0 = off).
    pv_supervision: train `PVSupervisionHead` on the PV features beside the model.
    bev_supervision: train `BEVSupervisionHead` on the BEV features beside the model.
    """

    recipe: str = "cpu"
    steps: Positive = 10_000
    epochs: Positive | None = None
    batch_size: Positive = 2
    seed: Annotated[int, Field(strict=True, ge=0, lt=1000)] = 0

    tasks: Literal["both", "detection", "maps"] = "both"
    history: Literal["stream", "windows"] = "stream"
    history_strides: Annotated[tuple[Positive, ...], Field(min_length=1)] = (1,)
    past_frames: Count | None = None
    frames_per_clip: Positive = 6
    class_balanced: Flag = False
    photometric: Flag = False
    geometric: Flag = False
    grid_mask: Share = 0.0
    grid_mask_ramp: Flag = True

    learning_rate: Rate = 4e-4
    backbone_learning_rate: Rate = 4e-4
    weight_decay: Weight = 0.01
    warmup_steps: Count = 200
    warmup_start: Share = 0.005
    final_learning_rate: Share = 0.0
    clip_norm: Rate = 25.0
    ema_decay: ShareBelowOne = 0.0
    amp: Literal["off", "bfloat16", "float16"] = "bfloat16"
    frozen_stages: Annotated[int, Field(strict=True, ge=0, le=4)] = 0
    backbone_norm_eval: Flag = False
    frozen_parts: tuple[Part, ...] = ()
    norm_eval: Flag = False
    dropout: ShareBelowOne = 0.0

    match_class_cost: Weight = 2.0
    match_box_cost: Weight = 0.25
    match_box_weights: PoseWeights = (2.0, 2.0, 2.0, 0.5, 0.5, 0.5, 0.0, 0.0, 0.0, 0.0)
    auxiliary_matches: Positive = 3
    class_weight: Weight = 2.0
    box_weight: Weight = 0.25
    box_loss_weights: PoseWeights = (2.0, 2.0, 2.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0)
    loss_average: Literal["frame", "batch"] = "frame"
    box_loss_min_score: ShareBelowOne = 0.0
    yaw_free_classes: tuple[str, ...] = ()
    map_focal_weight: Weight = 10.0
    map_dice_weight: Weight = 1.0

    content_init: Literal["normal", "xavier"] = "normal"
    anchor_size: Literal["car", "mean"] = "car"

    pretraining: Flag = False
    denoising: Count = 1
    pv_supervision: Flag = True
    bev_supervision: Flag = True

    @field_validator("pv_supervision")
    @classmethod
    def _pretraining_needs_pv_supervision(cls, pv_supervision: bool, earlier: ValidationInfo) -> bool:
        if earlier.data.get("pretraining") and not pv_supervision:
            raise PydanticCustomError("pv_supervision", "expected True with pretraining, which has no other loss")
        return pv_supervision

    def to_dict(self) -> dict[str, Any]:
        """The settings as plain JSON values."""
        return TypeAdapter(type(self)).dump_python(self, mode="json")

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> "Settings":
        """The inverse of `to_dict`. Raises ValueError for a field that is missing, unknown or of the wrong type."""
        return TypeAdapter(cls).validate_python(values)
