"""What a bundle of a configuration promises: the manifest, before anything has been measured."""

from importlib.metadata import version

import torch

from ..model import DuoSpaceNetConfig
from ..runtime.bundle.manifest import (
    SCHEMA_VERSION,
    DeformableForm,
    GraphName,
    GraphSpec,
    Manifest,
    PerceptionRange,
    TensorSpec,
    WeightsRecord,
)
from ..weights.input_contract import preprocessing, temporal_window
from .graphs import Graph, memory_names
from .tracing import OPSET

PACKAGES = ("duospacenet", "torch", "onnx", "onnx-ir", "onnxscript", "onnxruntime")

_DTYPES = {torch.float32: "float32", torch.uint8: "uint8", torch.bool: "bool"}

FRAMES_OF_REFERENCE = {
    "ego": "x forward, y left, z up [m]; boxes, poses and map masks are given in it",
    "camera": "z forward, x right, y down [m]",
    "image": "pixels of the network's input, the centre of the first one at (0.5, 0.5)",
    "image_T_ego": "intrinsics after resize and crop, times camera_T_ego; maps ego points to homogeneous pixels",
    "past_T_now": "maps points of the current ego frame to the ego frame of slot t",
    "boxes": "x y z w l h [m], yaw [rad] about z, 0 along x, length along the heading; vx vy [m/s] over ground",
    "masks": "mask[0, 0, i, j] is the cell at x_i (forward) and y_j (left), both ascending",
}


TENSORS = {
    "images": "pictures scaled and cut, cameras in any order; zeros for a lost camera or one that the rig has not",
    "camera_valid": "false for those",
    "image_T_ego": "zeros for a camera that the rig has not, and in empty slots",
    "slotT.NAME": "what the outputs called NAME in `memory` were T frames ago, slot0 being now; anything if empty",
    "frame_valid": "false for a slot that holds no frame; slot0 always holds one",
    "past_T_now": "the identity in slot0 and in empty slots",
    "time_delta_s": "how long ago, not negative; 0 in slot0 and in empty slots",
    "sampling_grid, voxel_weight": "from the projector to the lifter; run it when a projection or camera_valid changes",
    "class_logits": "a score is 1 / (1 + exp(-logit)); the best 500 (query, class) pairs are the detections",
    "map classes": "a probability is 1 / (1 + exp(-logit))",
}


def manifest(
    config: DuoSpaceNetConfig,
    weights: WeightsRecord,
    graphs: list[Graph],
    digests: dict[GraphName, str],
    dcn: DeformableForm = "native",
) -> Manifest:
    """The manifest of traced graphs; `digests` holds each graph file's sha256 by graph name."""
    voxels = config.voxels
    return Manifest(
        schema_version=SCHEMA_VERSION,
        versions={name: version(name) for name in PACKAGES},
        preset=config.preset,
        config=config.to_dict(),
        classes=config.classes,
        map_classes=config.map_classes,
        num_cameras=config.num_cameras,
        preprocessing=preprocessing(config),
        window=temporal_window(config),
        perception=PerceptionRange(size=voxels.size, lower_m=voxels.lower_m, upper_m=voxels.upper_m),
        frames_of_reference=FRAMES_OF_REFERENCE,
        tensors=TENSORS,
        memory=tuple(memory_names(config)),
        precision="float32",
        dcn=dcn if config.is_deformable else None,
        weights=weights,
        graphs={graph.name: describe(graph, digests[graph.name]) for graph in graphs},
    )


def graph_file(name: str) -> str:
    """The file of a graph in the bundle's folder."""
    return f"{name}.onnx"


def describe(graph: Graph, digest: str) -> GraphSpec:
    """The file of a graph, its sha256 `digest`, and its tensors by name, shape and type."""
    return GraphSpec(
        file=graph_file(graph.name),
        sha256=digest,
        inputs=tuple(_tensor_spec(name, tensor) for name, tensor in graph.inputs.items()),
        outputs=tuple(_tensor_spec(name, tensor) for name, tensor in graph.outputs.items()),
        opsets={"": OPSET},
    )


def _tensor_spec(name: str, tensor: torch.Tensor) -> TensorSpec:
    return TensorSpec.model_validate({"name": name, "shape": tuple(tensor.shape), "dtype": _DTYPES[tensor.dtype]})
