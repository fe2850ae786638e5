"""The stateless form of a model: one module, and one ONNX graph, that takes the images of the whole window.

Most exports of temporal detectors have this form. It encodes every frame of the window again for each result, where a
bundle encodes only the newest one. `duospacenet bench` measures both. A bundle never contains it.
"""

from pathlib import Path

import torch
from torch import Tensor, nn

from ..model import DuoSpaceNet
from ..model.pose_vectors import decode_boxes
from ..model.window import Window
from ..runtime.bundle.manifest import DeformableForm, GraphSpec, sha256
from ..runtime.bundle.operators import DEFAULT_OPSET
from .graphs import Graph, result_tensors, window_tensors
from .manifest_builder import graph_spec
from .operator_forms import OperatorForms
from .tracing import trace

NAME = "stateless"
INPUTS = ("images", *Window._fields)


class StatelessModel(nn.Module):
    """`DuoSpaceNet.forward` with the outputs of a bundle: class logits (Q, classes), boxes (Q, 9), map logits."""

    def __init__(self, model: DuoSpaceNet) -> None:
        super().__init__()
        self.model = model

    def forward(self, images: Tensor, *window: Tensor) -> tuple[Tensor, ...]:
        """images (T, N, H, W, 3) uint8 BGR, index 0 the current frame. window: the fields of `Window`, in order.

        Returns the class logits, the boxes, and one map of logits (1, 1, X, Y) per map class.
        """
        output = self.model(images, *window)
        prediction = output.predictions[-1]
        return prediction.class_logits, decode_boxes(prediction.pose), *output.maps.values()


def export_stateless(
    model: DuoSpaceNet, path: Path, dcn: DeformableForm = "native", opset: int = DEFAULT_OPSET
) -> GraphSpec:
    """Write the stateless form of a model as one ONNX file in the grid-sample form, and return its description.

    dcn: form of the deformable convolutions of the backbone.
    opset: version of ONNX's operator set.
    """
    graph = stateless_graph(model.eval())
    trace(graph, path, OperatorForms(dcn, "grid-sample", opset))
    return graph_spec(graph, sha256(path), opset)


def stateless_graph(model: DuoSpaceNet) -> Graph:
    """The stateless form of a model as a graph, with inputs and outputs on the meta device."""
    config = model.config
    size, cameras, image = config.num_frames, config.num_cameras, config.image
    images = torch.empty(size, cameras, image.height_px, image.width_px, 3, dtype=torch.uint8, device="meta")
    inputs = {"images": images, **window_tensors(config)}
    # Its name is not one of a bundle's graphs, because no bundle contains it.
    return Graph(NAME, StatelessModel(model), inputs, result_tensors(config))  # type: ignore[arg-type]
