"""Checks that a manifest agrees with the inputs and outputs of its own graphs: cameras, sizes, classes and window."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from ..errors import ArtifactError
from .manifest import MANIFEST_NAME, GraphName, Manifest, TensorSpec, slot_name

Specs = dict[str, TensorSpec]


def check_consistency(bundle: Path, manifest: Manifest) -> None:
    """Compare the fields of a manifest with the tensors of its graphs. Raises ArtifactError, naming the field."""
    for field, expected, got in _comparisons(manifest):
        if expected != got:
            path = bundle / MANIFEST_NAME
            raise ArtifactError(
                f"{path}: field {field}: expected {expected}, as in its graphs; got {got}. Export again."
            )


def _comparisons(manifest: Manifest) -> Iterator[tuple[str, Any, Any]]:
    """Yield the name of each field, its value by the graphs' tensors, and its value in the manifest."""
    images = _inputs(manifest, "backbone").get("images")
    decoder, logits = _inputs(manifest, "decoder"), _outputs(manifest, "decoder").get("class_logits")
    bev, image = _outputs(manifest, "lifter").get("bev"), manifest.preprocessing
    num_frames = manifest.window.num_frames
    yield "num_cameras", _num_cameras(manifest), manifest.num_cameras
    cameras_per_run = _size(images, 0) or 1
    yield "num_cameras", f"a multiple of {cameras_per_run}", _multiple(manifest.num_cameras, cameras_per_run)
    yield "preprocessing.height_px", _size(images, 1), image.height_px
    yield "preprocessing.width_px", _size(images, 2), image.width_px
    yield "classes", f"{_size(logits, 1)} names", f"{len(manifest.classes)} names"
    yield "map_classes", tuple(_outputs(manifest, "segmenter")), manifest.map_classes
    if bev is not None:
        yield "perception.size", (_size(bev, 2), _size(bev, 3)), manifest.perception.size[:2]
    yield "window.num_frames", _size(decoder.get("frame_valid"), 0), num_frames
    available = {*_outputs(manifest, "backbone"), *_outputs(manifest, "lifter")}
    expected_slots = {slot_name(t, name) for t in range(num_frames) for name in manifest.memory}
    decoder_slots = {name for name in decoder if name.startswith("slot")}
    yield "memory, names that no graph outputs", [], sorted(set(manifest.memory) - available)
    yield "memory, slots that differ from the decoder's inputs", [], sorted(expected_slots ^ decoder_slots)[:3]


def _num_cameras(manifest: Manifest) -> int | None:
    """Return the number of cameras by the decoder's inputs, or by the projector's if the decoder has no such input."""
    in_window, now = (_inputs(manifest, graph).get("camera_valid") for graph in ("decoder", "projector"))
    return _size(now, 0) if in_window is None else _size(in_window, 1)


def _multiple(number: int, divisor: int) -> str:
    return f"a multiple of {divisor}" if number % divisor == 0 else str(number)


def _inputs(manifest: Manifest, graph: GraphName) -> Specs:
    return {spec.name: spec for spec in manifest.graphs[graph].inputs} if graph in manifest.graphs else {}


def _outputs(manifest: Manifest, graph: GraphName) -> Specs:
    return {spec.name: spec for spec in manifest.graphs[graph].outputs} if graph in manifest.graphs else {}


def _size(spec: TensorSpec | None, axis: int) -> int | None:
    """Return the size of one axis of a tensor, or None if there is no such tensor or axis."""
    return spec.shape[axis] if spec is not None and axis < len(spec.shape) else None
