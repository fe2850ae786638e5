"""Matching the tensors of a checkpoint with those of a model."""

import re
from collections.abc import Collection, Mapping, Sequence
from fnmatch import fnmatchcase
from math import isfinite
from typing import NamedTuple

import torch
from torch import Tensor

from .checkpoint_layout import Layout
from .checkpoint_report import CheckpointReport, TensorMismatch, shorten
from .checkpoint_wrappers import Unwrapped

_FLOATS = (torch.float16, torch.bfloat16, torch.float32, torch.float64)
_NECK = "image_encoder.neck."
_ANY_NECK = r"image_encoder\.neck\.|(img_)?neck\."  # our name, or a name without a counterpart in our neck


def match_tensors(
    source: Unwrapped,
    layout: Layout,
    expected: Mapping[str, Tensor],
    allow_missing: Sequence[str] = (),
    ignore: Sequence[str] = (),
    metadata: Mapping[str, str] | None = None,
) -> CheckpointReport:
    """Match the tensors of a file with those of a model.

    source: the tensors of the file.
    layout: the naming scheme of the file.
    expected: the model's tensors, by name.
    allow_missing: shell patterns of our names. A missing tensor that matches one of them is not a fault.
    ignore: shell patterns of names in the file. A tensor that matches one of them is treated as if it were not there.
    metadata: the metadata of the file.
    """
    ignored = {name: pattern for name in source.tensors if (pattern := _first_match(name, ignore))}
    our_names = {name: layout.our_name(name) for name in source.tensors if name not in ignored}
    misfit = _misfitting_neck(source.tensors, layout, our_names, expected, allow_missing)
    our_names |= dict.fromkeys(misfit)
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
        ignored=ignored,
        missing=tuple(name for name in absent if name not in allowed),
        unexpected=tuple(
            file_name for file_name, name in our_names.items() if name is not None and name not in expected
        ),
        misshapen=_shape_mismatches(pairs),
        mistyped=_type_mismatches(pairs),
        not_finite=tuple(not_finite),
        left_aside=(*source.left_aside, *(file_name for file_name, name in our_names.items() if name is None)),
        notes=(
            *source.notes,
            *_notes_on_misfit(misfit),
            *_notes_on_unused_patterns("--allow-missing", allow_missing, absent, "missing tensor"),
            *_notes_on_unused_patterns("--ignore", ignore, source.tensors, "tensor of the file"),
        ),
        metadata=dict(metadata or {}),
    )


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


def _first_match(name: str, patterns: Sequence[str]) -> str | None:
    return next((pattern for pattern in patterns if fnmatchcase(name, pattern)), None)


def _misfitting_neck(
    tensors: Mapping[str, Tensor],
    layout: Layout,
    our_names: Mapping[str, str | None],
    expected: Mapping[str, Tensor],
    allow_missing: Sequence[str],
) -> list[str]:
    """The names of the file's neck, if it is not the model's and the model's may be missing. Empty otherwise.

    Detectors with the same backbone have necks with other inputs and levels. A neck is loaded as a whole or not at all.
    """
    if layout.name != "mmdetection3d":
        return []
    neck = [file_name for file_name, name in our_names.items() if name and re.match(_ANY_NECK, name)]
    shapes = {name: tensor.shape for name, tensor in expected.items() if name.startswith(_NECK)}
    fits = all(shapes.get(our_names[file_name] or "") == _shape(tensors[file_name]) for file_name in neck)
    may_be_missing = all(_first_match(name, allow_missing) for name in shapes)
    return [] if fits or not shapes or not may_be_missing else neck


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


def _shape(tensor: Tensor) -> torch.Size | None:
    return None if tensor.is_nested else tensor.shape


def _notes_on_misfit(neck: Sequence[str]) -> list[str]:
    if not neck:
        return []
    return [
        "the neck in the file has other levels or inputs than the model's. It is left aside as a whole, because "
        f"{_NECK}* may be missing: {shorten(neck)}"
    ]


def _notes_on_unused_patterns(option: str, patterns: Sequence[str], names: Collection[str], kind: str) -> list[str]:
    unused = [pattern for pattern in patterns if not any(fnmatchcase(name, pattern) for name in names)]
    return [f"the {option} pattern {pattern} matches no {kind}" for pattern in unused]


def _is_finite(tensor: Tensor) -> bool:
    # aminmax reads the numbers once, and returns a NaN if there is any.
    return tensor.numel() == 0 or all(isfinite(number) for number in tensor.detach().aminmax())
