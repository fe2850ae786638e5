"""The report on a checkpoint: which of its tensors match a model, and which are missing or wrong."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from fnmatch import fnmatchcase
from math import isfinite
from typing import Any, NamedTuple

import torch
from torch import Tensor

from ..runtime.bundle.manifest import LayoutName
from .checkpoint_layout import Layout
from .checkpoint_wrappers import Unwrapped

_NAMES_SHOWN = 5  # of each kind of fault, in a message
_SUPPORTED_LAYOUTS = (
    "supported are this toolkit's own names, torchvision's ResNet, detectron2's VoVNet, alone or under "
    "backbone.bottom_up, and mmdetection3d's img_backbone and img_neck"
)
_FLOATS = (torch.float16, torch.bfloat16, torch.float32, torch.float64)


@dataclass(frozen=True)
class TensorMismatch:
    """A tensor with a wrong shape or type.

    name: the name in the model.
    file_name: the name in the file.
    expected, got: the shapes or types of the two tensors, as text.
    """

    name: str
    file_name: str
    expected: str
    got: str

    def __str__(self) -> str:
        alias = "" if self.file_name == self.name else f"{self.file_name} in the file, "
        return f"{self.name} ({alias}expected {self.expected}, got {self.got})"


@dataclass(frozen=True)
class CheckpointReport:
    """The comparison of the tensors of a checkpoint with those of a model.

    "Our names" are those of the model's state dict.

    layout: the naming scheme of the file.
    wrappers: the wrappers around its tensors, outermost first.
    num_expected: number of tensors in the model.
    matched: names in the file, by our names.
    allowed_missing: the patterns that allow tensors to be missing, by our names of these tensors.
    missing: our names of missing tensors.
    unexpected: names in the file without a counterpart in the model.
    misshapen: tensors with a wrong shape.
    mistyped: tensors with a wrong dtype, memory layout or device.
    not_finite: our names of tensors with a NaN or an infinity.
    left_aside: names in the file of unused tensors: of parts that the model does not have, and of other copies of the
        weights.
    notes: remarks, such as requirements that cannot be checked.
    metadata: the file's metadata.

    Names in the file do not include the wrappers, except for other copies in `left_aside`. A BatchNorm without
    `num_batches_tracked` is not reported, because inference does not use it.
    """

    layout: LayoutName
    wrappers: tuple[str, ...]
    num_expected: int
    matched: dict[str, str]
    allowed_missing: dict[str, str]
    missing: tuple[str, ...]
    unexpected: tuple[str, ...]
    misshapen: tuple[TensorMismatch, ...]
    mistyped: tuple[TensorMismatch, ...]
    not_finite: tuple[str, ...]
    left_aside: tuple[str, ...]
    notes: tuple[str, ...]
    metadata: dict[str, str]

    @property
    def faults(self) -> dict[str, list[str]]:
        """The reasons to refuse the file, by kind: one text per tensor."""
        kinds: dict[str, Sequence[str | TensorMismatch]] = {
            "missing": self.missing,
            "unexpected": self.unexpected,
            "mis-shaped": self.misshapen,
            "mis-typed": self.mistyped,
            "not finite": self.not_finite,
        }
        return {kind: [str(tensor) for tensor in tensors] for kind, tensors in kinds.items()}

    @property
    def accepted(self) -> bool:
        """Whether the file may be loaded: it has a matching tensor and no faults."""
        return bool(self.matched) and not any(self.faults.values())

    @property
    def verdict(self) -> str:
        """One line with the number of matched tensors, or with the faults and a few names of each kind."""
        if self.accepted:
            return f"{len(self.matched)} tensors matched, {len(self.allowed_missing)} allowed to be missing"
        faults = [f"{len(names)} {kind}: {_shorten(names)}" for kind, names in self.faults.items() if names]
        return "; ".join(faults if self.matched else [*faults, f"no tensor matches ({_SUPPORTED_LAYOUTS})"])

    def with_notes(self, notes: Sequence[str]) -> "CheckpointReport":
        """The same report with further notes."""
        return replace(self, notes=(*self.notes, *notes))

    def to_dict(self) -> dict[str, Any]:
        """The report as plain JSON values."""
        return {"accepted": self.accepted} | asdict(self)


class _Pair(NamedTuple):
    """A tensor of the file and the model's tensor of the same name."""

    name: str
    file_name: str
    tensor: Tensor
    expected: Tensor

    @property
    def has_shape(self) -> bool:
        return self.tensor.shape == self.expected.shape

    @property
    def has_type(self) -> bool:
        """Whether the tensor is dense, on the CPU, and of the expected dtype. The dtypes in _FLOATS count as equal."""
        dtypes = _FLOATS if self.expected.is_floating_point() else (self.expected.dtype,)
        dense = self.tensor.layout == torch.strided and not self.tensor.is_nested
        return dense and self.tensor.device.type == "cpu" and self.tensor.dtype in dtypes

    @property
    def is_finite(self) -> bool:
        """Whether all numbers are finite after the conversion to the model's dtype, in which large doubles overflow."""
        return _is_finite(self.tensor.to(self.expected.dtype))


def match_tensors(
    source: Unwrapped,
    layout: Layout,
    expected: Mapping[str, Tensor],
    allow_missing: Sequence[str] = (),
    metadata: Mapping[str, str] | None = None,
) -> CheckpointReport:
    """Match the tensors of a file with those of a model.

    source: the tensors of the file.
    layout: the naming scheme of the file.
    expected: the model's tensors, by name.
    allow_missing: shell patterns of our names. A missing tensor that matches one of them is not a fault.
    metadata: the metadata of the file.
    """
    our_names = {file_name: layout.our_name(file_name) for file_name in source.tensors}
    known = {name: file_name for file_name, name in our_names.items() if name is not None and name in expected}
    pairs = [_Pair(name, file_name, source.tensors[file_name], expected[name]) for name, file_name in known.items()]
    absent = [name for name in expected if name not in known and not name.endswith("num_batches_tracked")]
    allowed = {name: pattern for name in absent if (pattern := _first_match(name, allow_missing))}
    # Numbers are read only in tensors of the right shape and type: a tensor of another shape may be huge.
    fitting = [pair for pair in pairs if pair.has_type and pair.has_shape]
    not_finite = [pair.name for pair in fitting if not pair.is_finite]
    return CheckpointReport(
        layout=layout.name,
        wrappers=source.wrappers,
        num_expected=len(expected),
        matched={pair.name: pair.file_name for pair in fitting if pair.name not in not_finite},
        allowed_missing=allowed,
        missing=tuple(name for name in absent if name not in allowed),
        unexpected=tuple(
            file_name for file_name, name in our_names.items() if name is not None and name not in expected
        ),
        misshapen=_shape_mismatches(pairs),
        mistyped=_type_mismatches(pairs),
        not_finite=tuple(not_finite),
        left_aside=(*source.left_aside, *(file_name for file_name, name in our_names.items() if name is None)),
        notes=(*source.notes, *_notes_on_unused_patterns(allow_missing, absent)),
        metadata=dict(metadata or {}),
    )


def _first_match(name: str, patterns: Sequence[str]) -> str | None:
    return next((pattern for pattern in patterns if fnmatchcase(name, pattern)), None)


def _shape_mismatches(pairs: Sequence[_Pair]) -> tuple[TensorMismatch, ...]:
    # A nested tensor has no shape. It is reported as a tensor of the wrong type.
    return tuple(
        TensorMismatch(pair.name, pair.file_name, str(tuple(pair.expected.shape)), str(tuple(pair.tensor.shape)))
        for pair in pairs
        if not pair.tensor.is_nested and not pair.has_shape
    )


def _type_mismatches(pairs: Sequence[_Pair]) -> tuple[TensorMismatch, ...]:
    return tuple(
        TensorMismatch(
            *(pair.name, pair.file_name, str(pair.expected.dtype)),
            got=f"{pair.tensor.dtype}, {pair.tensor.layout}, on {pair.tensor.device}",
        )
        for pair in pairs
        if not pair.has_type
    )


def _notes_on_unused_patterns(patterns: Sequence[str], absent: Sequence[str]) -> list[str]:
    unused = [pattern for pattern in patterns if not any(fnmatchcase(name, pattern) for name in absent)]
    return [f"the --allow-missing pattern {pattern} matches no missing tensor" for pattern in unused]


def _is_finite(tensor: Tensor) -> bool:
    # aminmax reads the numbers once, and returns a NaN if there is any.
    return tensor.numel() == 0 or all(isfinite(number) for number in tensor.detach().aminmax())


def _shorten(names: list[str]) -> str:
    more = f", and {len(names) - _NAMES_SHOWN} more" if len(names) > _NAMES_SHOWN else ""
    return ", ".join(names[:_NAMES_SHOWN]) + more
