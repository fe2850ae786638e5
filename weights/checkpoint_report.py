"""The report on a checkpoint: which of its tensors match a model, and which are missing or wrong."""

import glob
import shlex
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from fnmatch import fnmatchcase
from typing import Any

from ..runtime.bundle.manifest import LayoutName

_NAMES_SHOWN = 5  # of each kind of fault, in a message
_SUPPORTED_LAYOUTS = (
    "supported are this toolkit's own names, torchvision's ResNet, detectron2's VoVNet, alone or under "
    "backbone.bottom_up, and mmdetection3d's img_backbone and img_neck, or backbone and neck"
)


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
    ignored: the patterns that exclude tensors of the file, by their names in the file.
    missing: our names of missing tensors.
    unexpected: names in the file without a counterpart in the model.
    misshapen: tensors with a wrong shape.
    mistyped: tensors with a wrong dtype, memory layout or device.
    not_finite: our names of tensors with a NaN or an infinity.
    left_aside: names in the file of unused tensors: of parts that the model does not have, of a neck that does not
        fit, and of other copies of the weights.
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
    ignored: dict[str, str]
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
        faults = [f"{len(names)} {kind}: {shorten(names)}" for kind, names in self.faults.items() if names]
        return "; ".join(faults if self.matched else [*faults, f"no tensor matches ({_SUPPORTED_LAYOUTS})"])

    @property
    def advice(self) -> tuple[str, ...]:
        """What a user can do about the faults: one sentence each."""
        lines = []
        if self.missing:
            lines.append(f"Missing tensors can be initialised at random: --allow-missing '{_part(self.missing[0])}.*'.")
        if misfits := [*self.unexpected, *(mismatch.file_name for mismatch in self.misshapen)]:
            pattern = self._ignore_pattern(misfits[0])
            quoted = shlex.quote(pattern) if "'" in pattern else f"'{pattern}'"
            lines.append(f"Tensors of the file can be left out: --ignore {quoted}.")
        return tuple(lines)

    def _ignore_pattern(self, misfit: str) -> str:
        """The part of a foreign file that a misfit belongs to, or the misfit alone if others of its part are loaded."""
        pattern = f"{glob.escape(_part(misfit))}.*"
        is_loaded = self.layout == "own" and any(fnmatchcase(name, pattern) for name in self.matched.values())
        return glob.escape(misfit) if is_loaded or "." not in misfit else pattern

    def with_notes(self, notes: Sequence[str]) -> "CheckpointReport":
        """The same report with further notes."""
        return replace(self, notes=(*self.notes, *notes))

    def to_dict(self) -> dict[str, Any]:
        """The report as plain JSON values."""
        return {"accepted": self.accepted} | asdict(self)


def shorten(names: Sequence[str]) -> str:
    """The first few names, and the number of the others."""
    more = f", and {len(names) - _NAMES_SHOWN} more" if len(names) > _NAMES_SHOWN else ""
    return ", ".join(names[:_NAMES_SHOWN]) + more


def _part(name: str) -> str:
    """The part of a model that a tensor belongs to: the first part of its name, or the first two of the encoder's."""
    parts = name.split(".")
    return ".".join(parts[: 2 if parts[0] == "image_encoder" else 1])
