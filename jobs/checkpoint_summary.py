"""A short description of the checkpoint that a bundle's weights came from."""

from collections import Counter
from collections.abc import Iterable

from ..runtime.bundle.manifest import CheckpointRecord

LAYOUT_DESCRIPTIONS = {
    "own": "this toolkit's own names",
    "torchvision": "torchvision's names of a ResNet",
    "vovnet": "detectron2's names of a VoVNet",
    "mmdetection3d": "mmdetection3d's names of an image backbone and neck",
}


def describe_checkpoint(record: CheckpointRecord) -> list[str]:
    """One line per fact: tensors that matched, were missing and were ignored, and notes."""
    names = LAYOUT_DESCRIPTIONS[record.layout]
    lines = [f"{record.matched} tensors with {names}{describe_wrappers(record.wrappers)}"]
    if record.missing:
        patterns = ", ".join(dict.fromkeys(record.missing.values()))
        missing = f"{len(record.missing)} missing tensors, allowed by {patterns}"
        lines.append(f"{missing}: randomly initialised from seed {record.seed}")
    if record.ignored:
        patterns = ", ".join(dict.fromkeys(record.ignored.values()))
        lines.append(f"{len(record.ignored)} tensors of the file left out, by --ignore {patterns}")
    if record.left_aside:
        lines.append(f"{len(record.left_aside)} tensors ignored: {group_names(record.left_aside)}")
    return lines + [f"note: {note}" for note in record.notes]


def describe_wrappers(wrappers: Iterable[str]) -> str:
    """The keys of the file around the tensors, such as ", inside state_dict"; empty without any."""
    path = ".".join(wrappers)
    return f", inside {path}" if path else ""


def group_names(names: Iterable[str]) -> str:
    """Tensor names grouped by their first two parts, with the number of tensors in each group."""
    names = list(names)
    if len(names) <= 2:
        return ", ".join(names)
    groups = Counter(".".join(name.split(" ")[0].split(".")[:2]) for name in names)
    return ", ".join(f"{group} ({count})" if count > 1 else group for group, count in groups.items())
