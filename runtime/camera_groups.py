"""A backbone that takes fewer cameras than there are: it runs group by group, and its outputs are concatenated."""

from collections.abc import Mapping

import numpy as np
import onnxruntime as ort

from .bundle.manifest import GraphSpec
from .session import Session, Tensors, to_tensors


class CameraGroups:
    """A session for the images of all N cameras, around `session` for the images of b cameras; N is a multiple of b.

    For large images it takes less time and memory to encode one camera after the other. A group of lost cameras takes
    no time: it is not run, and its features are zeros.
    """

    def __init__(self, session: Session, spec: GraphSpec, num_cameras: int) -> None:
        """spec: the manifest's entry of the backbone. num_cameras: N."""
        self.session = session
        self._size = spec.inputs[0].shape[0]
        self._num_cameras = num_cameras
        self._shapes = {tensor.name: tensor.shape for tensor in spec.outputs}

    @property
    def precision(self) -> str:
        """The number format of the session."""
        return self.session.precision

    def run(self, tensors: Mapping[str, ort.OrtValue]) -> Tensors:
        """Run the backbone on all cameras.

        tensors: `images` (N, H, W, 3); and `camera_valid` (N), without which every camera is run.

        Returns the outputs by name, (N, C, H, W).
        """
        images = tensors["images"].numpy()
        valid = tensors["camera_valid"].numpy() if "camera_valid" in tensors else np.ones(self._num_cameras, np.bool_)
        outputs = {name: _allocate((self._num_cameras, *shape[1:])) for name, shape in self._shapes.items()}
        arrays = {name: value.numpy() for name, value in outputs.items()}  # the same memory
        for first in range(0, self._num_cameras, self._size):
            cameras = slice(first, first + self._size)
            features = self.session.run(to_tensors(images=images[cameras])) if valid[cameras].any() else {}
            for name, array in arrays.items():
                array[cameras] = features[name].numpy() if features else 0.0
        return outputs


def _allocate(shape: tuple[int, ...]) -> ort.OrtValue:
    """An uninitialised tensor that owns its memory, as those that a graph returns. A wrapped array does not."""
    return ort.OrtValue.ortvalue_from_shape_and_type(shape, np.float32, "cpu")
