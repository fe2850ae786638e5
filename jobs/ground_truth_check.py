"""Checks before an evaluation: that the metrics of a bundle can be computed on a source."""

from collections.abc import Iterable
from pathlib import Path

from ..data.source import Source
from ..evaluation.protocol import CLASSES
from ..runtime.bundle.manifest import MANIFEST_NAME, Manifest
from ..runtime.errors import ArtifactError, InputError


def check_benchmark_classes(bundle: Path, manifest: Manifest, advice: str) -> None:
    """Raise ArtifactError if a bundle detects a class that the benchmark does not have. advice: what to do then."""
    unknown = [name for name in manifest.classes if name not in CLASSES]
    if unknown:
        raise ArtifactError(
            f"{bundle / MANIFEST_NAME}: field classes: expected classes of nuScenes' benchmark, {', '.join(CLASSES)}; "
            f"got {unknown[0]!r}. {advice}"
        )


def check_ground_truth(source: Source, name: str | Path, manifest: Manifest) -> None:
    """Raise InputError unless a frame has true boxes or, for a bundle with map classes, a true mask.

    name: the name of the source, for messages. The class names of the boxes must be known.
    """
    indices = range(len(source))
    if any(map(source.has_boxes, indices)):
        source.check_class_names(CLASSES)
    elif not manifest.map_classes:
        raise InputError(
            f"{name}: expected true boxes in at least one frame, because the bundle has no map classes; got none. "
            "Add `boxes` to the frames."
        )
    elif not any(map(source.has_maps, indices)):
        raise InputError(
            f"{name}: expected true boxes or masks to compare with, at least in one frame; got none. Add `boxes` or "
            "`maps` to the frames."
        )


def check_true_boxes(source: Source, name: str | Path, indices: Iterable[int], advice: str) -> None:
    """Raise InputError unless one of the frames has true boxes, and all class names are known.

    indices: of the frames. name: the name of the source, for messages. advice: what to do without boxes.
    """
    if not any(map(source.has_boxes, indices)):
        raise InputError(f"{name}: expected true boxes to compare with, at least in one frame; got none. {advice}")
    source.check_class_names(CLASSES)
