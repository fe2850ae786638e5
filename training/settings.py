"""The numbers of a training: frozen, checked when they are made, and kept in its checkpoint."""

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
    """One training. A step looks at one frame of each of `drives_per_step` drives, which are driven through side by
    side, `frames_per_drive` frames each; then come the next drives.

    steps: of the optimiser. learning_rate: of all but the backbone, at its peak; backbone_learning_rate: the paper
    starts from a trained backbone and gives it a tenth. warmup_steps: linear; a cosine to zero follows. clip_norm: of
    the gradient. grid_mask: the probability at the end, to which it grows linearly. auxiliary_matches: queries an
    object gets in the layers before the last. pretraining: the image encoder alone learns, by `PerspectiveHead`.
    denoising: sets of queries a frame that begin beside the objects. perspective, birds_eye: whether `PerspectiveHead`
    and `BirdsEyeHead` train along. bf16: whether convolutions compute in bfloat16. seed: of the start, the heads, the
    drives, the masks and the noise.
    """

    steps: Positive
    drives_per_step: Positive = 2
    frames_per_drive: Positive = 12
    learning_rate: Rate = 2e-4
    backbone_learning_rate: Rate = 2e-4
    weight_decay: Annotated[float, Field(ge=0, allow_inf_nan=False)] = 0.01
    warmup_steps: Annotated[int, Field(ge=0)] = 200
    clip_norm: Rate = 25.0
    grid_mask: Share = 0.0
    auxiliary_matches: Positive = 1
    pretraining: bool = False
    denoising: Annotated[int, Field(ge=0)] = 1
    perspective: bool = True
    birds_eye: bool = True
    bf16: bool = True
    seed: Annotated[int, Field(ge=0, lt=1000)] = 0

    @field_validator("perspective")
    @classmethod
    def _is_there_to_learn_by(cls, perspective: bool, earlier: ValidationInfo) -> bool:
        if earlier.data.get("pretraining") and not perspective:
            raise PydanticCustomError("perspective", "expected it with pretraining, which has nothing else to learn by")
        return perspective

    def to_dict(self) -> dict[str, Any]:
        """The settings as plain JSON values."""
        return asdict(self)

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> "Settings":
        """The inverse of `to_dict`. Raises ValueError for a field that is missing, unknown or of the wrong type."""
        return TypeAdapter(cls).validate_python(values)
