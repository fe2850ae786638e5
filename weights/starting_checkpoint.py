"""Checkpoints that a training starts from. They may hold a part of the model only, such as a backbone."""

import re
from collections import Counter, defaultdict
from collections.abc import Iterable, Sequence
from itertools import takewhile
from pathlib import Path

from ..model import DuoSpaceNet
from .checkpoint import load_checkpoint, read_checkpoint
from .checkpoint_report import CheckpointReport, shorten

_BACKBONE = "image_encoder.backbone"
_NECK = "image_encoder.neck"


def load_start(
    path: str | Path,
    model: DuoSpaceNet,
    allow_missing: Sequence[str] = (),
    ignore: Sequence[str] = (),
    weights_key: str | None = None,
) -> CheckpointReport:
    """Load the weights that a training starts from into `model`, in place, and return the report on every tensor.

    The arguments and errors are those of `load_checkpoint`, with one difference: a file of another code base need only
    hold a whole backbone. All other parts of the model that it lacks start anew. Their tensors keep their values. A
    neck that does not fit starts anew as well.
    """
    report = read_checkpoint(path, model, allow_missing, ignore, weights_key).report
    patterns = [*allow_missing, *_parts_that_may_be_missing(report)]
    return load_checkpoint(path, model, patterns, ignore, weights_key)


def describe_start(report: CheckpointReport) -> list[str]:
    """Lines that say which parts of the model the checkpoint gave, which start anew, and what of the file is unused.

    Empty if the checkpoint gave the whole model.
    """
    lines = {
        "loaded": _count_parts(report.matched),
        "starts anew": _count_parts(report.allowed_missing),
        "not used": _count_groups([*report.left_aside, *report.ignored]),
    }
    if not lines["starts anew"] and not lines["not used"]:
        return []
    return [f"{label}: {counts}" for label, counts in lines.items() if counts]


def _parts_that_may_be_missing(report: CheckpointReport) -> list[str]:
    """Patterns of the parts of the model, other than the backbone, that a file of another code base does not fill."""
    if report.layout == "own":
        return []
    parts = dict.fromkeys(map(_part, report.missing))
    misfits = [*report.unexpected, *(mismatch.file_name for mismatch in report.misshapen)]
    if any(re.match(r"(img_)?neck\.", name) for name in misfits):
        parts[_NECK] = None
    return [f"{part}.*" for part in parts if part != _BACKBONE]


def _part(name: str) -> str:
    """The part of the model that a tensor belongs to. The backbone and the neck are parts of their own."""
    return ".".join(name.split(".")[: 2 if name.startswith("image_encoder.") else 1])


def _count_parts(names: Iterable[str]) -> str:
    return _join(Counter(map(_part, names)))


def _count_groups(names: Sequence[str]) -> str:
    """Names of the file by their common beginning, such as `neck.fpn_convs.4.conv`."""
    groups = defaultdict(list)
    for name in names:
        groups[name.partition(".")[0]].append(name.split("."))
    return _join({".".join(_common_start(group)): len(group) for group in groups.values()})


def _common_start(paths: Sequence[Sequence[str]]) -> list[str]:
    """The parts at the start that all paths share."""
    return [parts[0] for parts in takewhile(lambda parts: len(set(parts)) == 1, zip(*paths, strict=False))]


def _join(counts: dict[str, int]) -> str:
    return shorten([f"{name} ({count} tensor{'s' if count > 1 else ''})" for name, count in counts.items()])
