"""How the tensors of a checkpoint fit a model: which are matched, which are missing, and what cannot be."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from fnmatch import fnmatchcase
from math import isfinite
from typing import Any

import torch
from torch import Tensor

from .checkpoint_layout import Layout, LayoutName, Unwrapped

_SHOWN = 5  # names in a message
_KNOWN = (
    "known are this toolkit's own names, torchvision's ResNet, detectron2's VoVNet, alone or under backbone.bottom_up, "
    "and mmdetection3d's img_backbone and img_neck"
)
_FLOATS = (torch.float16, torch.bfloat16, torch.float32, torch.float64)


@dataclass(frozen=True)
class Misfit:
    """A tensor that cannot be where it belongs: our name, the file's, what the model expects there, what it is."""

    name: str
    file_name: str
    expected: str
    got: str

    def __str__(self) -> str:
        alias = "" if self.file_name == self.name else f"{self.file_name} in the file, "
        return f"{self.name} ({alias}expected {self.expected}, got {self.got})"


@dataclass(frozen=True)
class CheckpointReport:
    """What became of every tensor of the file and of the model.

    The file's names are those inside its wrappers. matched: they by ours. allowed_missing: the pattern that allowed it,
    by our name. left_aside: tensors of parts that are not ours, and of copies of the weights that were not taken, these
    with their wrappers. The other lists are faults: missing and not finite by our names, unexpected by the file's.
    BatchNorm's `num_batches_tracked`, which inference never reads, may always be absent and is listed nowhere then.
    """

    layout: LayoutName
    wrappers: tuple[str, ...]
    num_expected: int
    matched: dict[str, str]
    allowed_missing: dict[str, str]
    missing: tuple[str, ...]
    unexpected: tuple[str, ...]
    misshapen: tuple[Misfit, ...]
    mistyped: tuple[Misfit, ...]
    not_finite: tuple[str, ...]
    left_aside: tuple[str, ...]
    notes: tuple[str, ...]
    metadata: dict[str, str]

    @property
    def faults(self) -> dict[str, list[str]]:
        """What is wrong, by kind, a text for each tensor."""
        kinds: dict[str, Sequence[str | Misfit]] = {
            "missing": self.missing,
            "unexpected": self.unexpected,
            "mis-shaped": self.misshapen,
            "mis-typed": self.mistyped,
            "not finite": self.not_finite,
        }
        return {kind: [str(tensor) for tensor in tensors] for kind, tensors in kinds.items()}

    @property
    def accepted(self) -> bool:
        """Whether the file may be loaded. A file that fills nothing may not, whatever is allowed to be missing."""
        return bool(self.matched) and not any(self.faults.values())

    @property
    def verdict(self) -> str:
        """The faults in a line, a few names of each; or how much was matched."""
        if self.accepted:
            return f"{len(self.matched)} tensors matched, {len(self.allowed_missing)} allowed to be missing"
        found = [f"{len(names)} {kind}: {_shorten(names)}" for kind, names in self.faults.items() if names]
        return "; ".join(found if self.matched else [*found, f"none that fits ({_KNOWN})"])

    def with_notes(self, notes: Sequence[str]) -> "CheckpointReport":
        """The same report with further notes."""
        return replace(self, notes=(*self.notes, *notes))

    def to_dict(self) -> dict[str, Any]:
        """The report as plain JSON values."""
        return {"accepted": self.accepted} | asdict(self)


def survey(
    source: Unwrapped,
    layout: Layout,
    expected: Mapping[str, Tensor],
    allow_missing: Sequence[str] = (),
    metadata: Mapping[str, str] | None = None,
) -> CheckpointReport:
    """Hold the tensors of a file against those that a model expects.

    allow_missing: patterns of our names, as a shell has them; what is absent and matches one is no fault. Names come
    first, then kinds, and numbers last: only a tensor that fits is small enough, and of a kind, to look into.
    """
    ours = {name: layout.our_name(name) for name in source.tensors}
    known = {our: name for name, our in ours.items() if our in expected}
    pairs = {our: (name, source.tensors[name], expected[our]) for our, name in known.items()}
    absent = [name for name in expected if name not in known and not name.endswith("num_batches_tracked")]
    allowed = {name: pattern for name in absent if (pattern := _first_match(name, allow_missing))}
    idle = [pattern for pattern in allow_missing if not any(fnmatchcase(name, pattern) for name in absent)]
    fitting = [
        our for our, (_, tensor, want) in pairs.items() if _is_plain(tensor, want) and tensor.shape == want.shape
    ]
    # Looked at in the model's own type, in which a large number may be infinite.
    not_finite = [our for our in fitting if not _is_finite(pairs[our][1].to(expected[our].dtype))]
    return CheckpointReport(
        layout=layout.name,
        wrappers=source.wrappers,
        num_expected=len(expected),
        matched={our: known[our] for our in fitting if our not in not_finite},
        allowed_missing=allowed,
        missing=tuple(name for name in absent if name not in allowed),
        unexpected=tuple(name for name, our in ours.items() if our is not None and our not in expected),
        misshapen=tuple(
            Misfit(our, name, str(tuple(want.shape)), str(tuple(tensor.shape)))
            for our, (name, tensor, want) in pairs.items()
            if not tensor.is_nested and tensor.shape != want.shape
        ),
        mistyped=tuple(
            Misfit(our, name, str(want.dtype), f"{tensor.dtype}, {tensor.layout}, on {tensor.device}")
            for our, (name, tensor, want) in pairs.items()
            if not _is_plain(tensor, want)
        ),
        not_finite=tuple(not_finite),
        left_aside=(*source.left_aside, *(name for name, our in ours.items() if our is None)),
        notes=(*source.notes, *(f"allowed to be missing, but nothing missing matches: {pattern}" for pattern in idle)),
        metadata=dict(metadata or {}),
    )


def _first_match(name: str, patterns: Sequence[str]) -> str | None:
    return next((pattern for pattern in patterns if fnmatchcase(name, pattern)), None)


def _is_plain(tensor: Tensor, expected: Tensor) -> bool:
    """Whether the tensor holds plain numbers of the expected kind: any usual float for a float."""
    dtypes = _FLOATS if expected.is_floating_point() else (expected.dtype,)
    plain = tensor.layout == torch.strided and tensor.device.type == "cpu" and not tensor.is_nested
    return plain and tensor.dtype in dtypes


def _is_finite(tensor: Tensor) -> bool:
    """In one pass: a NaN is both the smallest and the largest number."""
    return tensor.numel() == 0 or all(isfinite(number) for number in tensor.detach().aminmax())


def _shorten(names: list[str]) -> str:
    more = f", and {len(names) - _SHOWN} more" if len(names) > _SHOWN else ""
    return ", ".join(names[:_SHOWN]) + more
