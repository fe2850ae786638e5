"""Build the manifest of a bundle from a configuration and its traced graphs, before the parity check."""

import torch

from ..model import DuoSpaceNetConfig
from ..runtime.bundle.manifest import (
    GraphName,
    GraphSpec,
    Manifest,
    PerceptionRange,
    TensorSpec,
    WeightsRecord,
    graph_file_name,
)
from ..runtime.bundle.schema_versions import SCHEMA_VERSION
from ..runtime.versions import library_versions
from ..weights.input_contract import preprocessing, temporal_window
from .graphs import Graph, cached_names
from .operator_forms import OperatorForms

LIBRARIES = ("duospacenet", "torch", "onnx", "onnx-ir", "onnxscript", "onnxruntime")

# The texts of FRAMES_OF_REFERENCE and TENSORS are for readers of manifest.json who write a consumer of their own.
FRAMES_OF_REFERENCE = {
    "ego": "The axes are x forward, y left and z up [m]. Boxes and map masks are in the ego frame.",
    "camera": "The axes are z forward, x right and y down [m].",
    "image": "Pixels of the resized and cropped image. The centre of the first pixel is at (0.5, 0.5).",
    "image_T_ego": "The intrinsics after resize and crop, times the upper three rows of camera_T_ego. "
    "It maps ego points to homogeneous pixels.",
    "past_T_now": "Maps points from the current ego frame to the ego frame of slot t.",
    "boxes": "The 9 numbers are x y z w l h [m], yaw [rad] and vx vy [m/s]. x y z is the centre. Yaw turns about z "
    "and is 0 along x. The length l is along the heading. The velocity is relative to the ground.",
    "masks": "mask[0, 0, i, j] is the cell at x_i (forward) and y_j (left). Both increase with the index.",
}

TENSORS = {
    "images": "One resized and cropped image per camera, in any camera order. All zeros for a lost camera and for an "
    "index beyond the cameras of the rig.",
    "reduced_pv_*, pv_value_*": "Outputs of the backbone for the cameras in `images`. If these are fewer than "
    "num_cameras, run the backbone for the next cameras too, and concatenate its outputs along the first axis. The "
    "features of a lost camera are masked, so they may be zeros.",
    "camera_valid": "False for a lost camera, for an index beyond the cameras of the rig, and in an empty slot. "
    "Otherwise true.",
    "image_T_ego": "One matrix per camera, in the camera order of `images`. All zeros for an index beyond the cameras "
    "of the rig, and in an empty slot.",
    "slotT.NAME": "The output NAME of the frame in slot T, which is T frames ago. `memory` lists the names. slot0 is "
    "the current frame. An empty slot may hold any values.",
    "frame_valid": "False for an empty slot. Always true for slot0.",
    "past_T_now": "The identity in slot0 and in an empty slot.",
    "time_delta_s": "Time of the current frame minus time of the frame in the slot [s]; never negative. 0 in slot0 and "
    "in an empty slot.",
    "voxel_locations, voxel_visible": "Outputs of the projector and inputs of the lifter. Run the projector again when "
    "image_T_ego or camera_valid changes.",
    "class_logits": "The score of a query and a class is 1 / (1 + exp(-logit)). The detections are the 500 "
    "(query, class) pairs with the highest scores.",
    "map classes": "The probability of a cell is 1 / (1 + exp(-logit)).",
}

_DTYPES = {torch.float32: "float32", torch.uint8: "uint8", torch.bool: "bool"}


def build_manifest(
    config: DuoSpaceNetConfig,
    weights: WeightsRecord,
    graphs: list[Graph],
    hashes: dict[GraphName, str],
    forms: OperatorForms | None = None,
) -> Manifest:
    """The manifest of a bundle of `config`, without a parity report.

    weights: provenance of the model's weights.
    graphs: from `graphs_to_export`.
    hashes: sha256 of each graph file, by graph name.
    forms: of the operators in the graphs; that of deformable convolutions is ignored if `config` has none.
    """
    voxels, forms = config.voxels, forms or OperatorForms()
    return Manifest(
        schema_version=SCHEMA_VERSION,
        versions=library_versions(LIBRARIES),
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
        memory=tuple(cached_names(config)),
        precision="float32",
        dcn=forms.dcn if config.is_deformable else None,
        attention=forms.attention,
        weights=weights,
        graphs={graph.name: graph_spec(graph, hashes[graph.name], forms.opset) for graph in graphs},
    )


def graph_spec(graph: Graph, sha256: str, opset: int) -> GraphSpec:
    """The manifest entry of a graph: file name, hash, operator set, and names, shapes and types of its tensors."""
    return GraphSpec(
        file=graph_file_name(graph.name),
        sha256=sha256,
        inputs=tuple(_tensor_spec(name, tensor) for name, tensor in graph.inputs.items()),
        outputs=tuple(_tensor_spec(name, tensor) for name, tensor in graph.outputs.items()),
        opsets={"": opset},
    )


def _tensor_spec(name: str, tensor: torch.Tensor) -> TensorSpec:
    return TensorSpec.model_validate({"name": name, "shape": tuple(tensor.shape), "dtype": _DTYPES[tensor.dtype]})
