"""The detections of a frame as the outputs of a response."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ...runtime import Detections
from ...runtime.bundle.manifest import Manifest

MAPS = "maps"


def response_arrays(detections: Detections, manifest: Manifest) -> dict[str, NDArray]:
    """Return the outputs of a response by the names of `serving_tensors.serving_outputs`, without rounding.

    Texts are object arrays of bytes in UTF-8. The maps (M, X, Y) are in the order of the manifest's map classes, and
    M is 0 if none were computed.
    """
    class_ids = {name: index for index, name in enumerate(manifest.classes)}
    arrays: dict[str, NDArray] = {
        "boxes": detections.boxes,
        "scores": detections.scores,
        "class_ids": np.array([class_ids[name] for name in detections.classes], np.int32),
        "attributes": _texts(detections.attributes),
        "history_frames": np.array([detections.history.frames], np.int32),
        "reset_reason": _texts([detections.history.reset_reason or ""]),
        "skipped": _texts([detections.skipped or ""]),
        "dropped": np.array([detections.dropped_queries, detections.dropped_map_cells], np.int32),
    }
    if manifest.map_classes:
        masks = [detections.maps[name] for name in manifest.map_classes if name in detections.maps]
        cells = manifest.perception.size[:2]
        arrays[MAPS] = np.stack(masks) if masks else np.zeros((0, *cells), np.float32)
    return {name: np.ascontiguousarray(array) for name, array in arrays.items()}


def _texts(texts: Sequence[str]) -> NDArray[np.object_]:
    return np.array([text.encode() for text in texts], dtype=object)
