"""Faults in the graphs of a bundle: mistakes of an export, a conversion or a manual edit in a file that still loads."""

from collections.abc import Callable
from typing import Any

import numpy as np
import onnx
from onnx import numpy_helper

from .bench import (
    Bench,
    constant,
    edit_weight,
    nodes_of,
    producer_of,
    set_attribute,
    splice,
)

Change = Callable[[onnx.ModelProto], None]


def in_graph(name: str, change: Change) -> Callable[[Bench], None]:
    """A fault that applies `change` to one graph file."""
    return lambda bench: bench.edit_graph(name, change)


def in_manifest(field: str, change: Callable[[Any], Any]) -> Callable[[Bench], None]:
    """A fault that changes one field of the manifest."""
    return lambda bench: bench.edit_manifest(lambda manifest: manifest.update({field: change(manifest[field])}))


def classes_in_another_order(bench: Bench) -> None:
    """The manifest lists the classes in the order of the nuScenes evaluation instead of the trained order."""

    def change(manifest: dict[str, Any]) -> None:
        manifest["classes"][2:5] = ["bus", "trailer", "construction_vehicle"]

    bench.edit_manifest(change)


def rgb_for_bgr(model: onnx.ModelProto) -> None:
    splice(model, "images", "Gather", np.array([2, 1, 0]), axis=-1)


def mean_not_subtracted(model: onnx.ModelProto) -> None:
    edit_weight(model, "image_encoder.normalisation.mean", np.zeros_like)


def subtraction_left_out(model: onnx.ModelProto) -> None:
    """The graph of a model that does not subtract the mean."""
    _replace(model, "sub", "Identity")


def one_weight_changed(model: onnx.ModelProto) -> None:
    def change(weight: np.ndarray) -> np.ndarray:
        weight[3, 2, 1, 1] *= 1.3
        return weight

    edit_weight(model, "backbone.layer2.0.conv2.weight", change)


def nan_in_a_weight(model: onnx.ModelProto) -> None:
    edit_weight(model, "lane_boundary.3.bias", lambda bias: np.full_like(bias, np.nan))


def weights_of_half_precision(model: onnx.ModelProto) -> None:
    edit_weight(model, "image_encoder.neck.output.0.weight", lambda weight: weight.astype(np.float16))


def batch_norm_epsilon(epsilon: float) -> Callable[[Bench], None]:
    """The first BatchNorm is folded into its convolution with `epsilon` instead of 1e-5."""

    def inject(bench: Bench) -> None:
        variance = bench.model.image_encoder.backbone.bn1.running_var.numpy()
        scale = np.sqrt((variance + 1e-5) / (variance + epsilon))

        def change(model: onnx.ModelProto) -> None:
            edit_weight(model, "backbone.conv1.weight", lambda weight: weight * scale[:, None, None, None])

        bench.edit_graph("backbone", change)

    return inject


def layer_norm_epsilon(epsilon: float) -> Callable[[Bench], None]:
    return in_graph("decoder", lambda model: set_attribute(producer_of(model, "layer_norm_2"), "epsilon", epsilon))


def softmax_over_the_queries(model: onnx.ModelProto) -> None:
    set_attribute(producer_of(model, "softmax"), "axis", 1)


def align_corners_flipped(model: onnx.ModelProto) -> None:
    set_attribute(nodes_of(model, "GridSample")[0], "align_corners", 1)


def border_instead_of_zeros(model: onnx.ModelProto) -> None:
    for node in nodes_of(model, "GridSample"):
        set_attribute(node, "padding_mode", "border")


def nearest_instead_of_bilinear(model: onnx.ModelProto) -> None:
    set_attribute(nodes_of(model, "GridSample")[0], "mode", "nearest")


def one_camera_per_location(model: onnx.ModelProto) -> None:
    """Only the first camera that sees a location is sampled. The number of cameras was frozen while tracing."""
    one = constant(model, np.array([1]), "fault.one")
    for node in nodes_of(model, "TopK"):
        _redirect(model, node.input[1], one)


def linear_pyramid(model: onnx.ModelProto) -> None:
    set_attribute(nodes_of(model, "Resize")[0], "mode", "linear")


def x_and_y_swapped_in_bev(model: onnx.ModelProto) -> None:
    """The BEV features are sampled around (x, y) instead of (y, x)."""
    for node in model.graph.node:
        if node.output[0].startswith("flip"):
            node.op_type = "Identity"
            del node.input[1:], node.attribute[:]


def attention_heads_exchanged(model: onnx.ModelProto) -> None:
    """The values of the first two heads of the second layer are exchanged. Query, key and value have 64 rows each."""
    rows = [*range(128), *range(144, 160), *range(128, 144), *range(160, 192)]
    edit_weight(model, "layers.1.self_attention.query_key_value.weight", lambda weight: weight[rows])


def velocity_not_rotated(model: onnx.ModelProto, num_layers: int = 1) -> None:
    """In the first layers the velocity is not rotated to the past frame. The graph holds it as (vx, vy, 0)."""
    identity = constant(model, np.eye(3)[None].repeat(4, axis=0))
    velocities = [node.output[0] for node in nodes_of(model, "Concat") if list(node.input[1:]) == ["zeros_like"]]
    for product in nodes_of(model, "MatMul"):
        if product.input[0] in velocities[:num_layers]:
            product.input[1] = identity


def sine_for_cosine(model: onnx.ModelProto) -> None:
    quotient = producer_of(model, producer_of(model, nodes_of(model, "Atan")[0].output[0]).input[0])
    quotient.input[:] = [quotient.input[1], quotient.input[0]]


def headings_exchanged(model: onnx.ModelProto) -> None:
    """In the first layer, sine and cosine of the yaw in past poses are exchanged."""
    node = producer_of(model, "cat_2")
    node.input[2], node.input[3] = node.input[3], node.input[2]


def yaw_negated(model: onnx.ModelProto) -> None:
    splice(model, "boxes", "Mul", np.array([1, 1, 1, 1, 1, 1, -1, 1, 1], np.float32))


def boxes_in_reversed_query_order(model: onnx.ModelProto) -> None:
    splice(model, "boxes", "Gather", np.arange(32)[::-1].copy(), axis=0)


def class_columns_exchanged(model: onnx.ModelProto) -> None:
    splice(model, "class_logits", "Gather", np.array([0, 1, 3, 2, 4, 5, 6, 7, 8, 9]), axis=1)


def maps_transposed(model: onnx.ModelProto) -> None:
    splice(model, "drivable_area", "Transpose", perm=[0, 1, 3, 2])


def maps_exchanged(model: onnx.ModelProto) -> None:
    one, other = producer_of(model, "drivable_area"), producer_of(model, "lane_boundary")
    one.output[0], other.output[0] = "lane_boundary", "drivable_area"


def frame_mask_inverted(model: onnx.ModelProto) -> None:
    _invert(model, "frame_valid")


def camera_mask_inverted(model: onnx.ModelProto) -> None:
    _invert(model, "camera_valid")


def larger_visible_depth(depth_m: float) -> Change:
    """The smallest visible depth is `depth_m` instead of 0.1 m."""

    def change(model: onnx.ModelProto) -> None:
        values = {tensor.name: numpy_helper.to_array(tensor) for tensor in model.graph.initializer}
        limits = [node for node in nodes_of(model, "Greater") if np.allclose(values.get(node.input[1], 0), 0.1)]
        larger = constant(model, np.full_like(values[limits[0].input[1]], depth_m))
        for node in limits:
            node.input[1] = larger

    return change


def time_made_constant(model: onnx.ModelProto) -> None:
    """The times are a constant from the traced example. Tracing does this to a value that passes through numpy."""
    example = constant(model, np.array([0, 0.5, 1.0, 1.5], np.float32), "traced_example")
    _redirect(model, "time_delta_s", example)


def motion_made_constant(model: onnx.ModelProto) -> None:
    _redirect(model, "past_T_now", constant(model, np.eye(4, dtype=np.float32)[None].repeat(4, axis=0)))


def slot_read_twice(model: onnx.ModelProto) -> None:
    _redirect(model, "slot2.pv_value_0_0", "slot1.pv_value_0_0")


def camera_features_exchanged(model: onnx.ModelProto) -> None:
    """The lifter exchanges the features of the first two cameras, which have the same shape."""
    splice(model, "reduced_pv_1", "Gather", np.array([1, 0, 2, 3, 4, 5]), axis=0)


def half_a_pixel_off(model: onnx.ModelProto) -> None:
    """The locations, which are fractions of the image, are shifted by half a pixel of an image of 160x64."""
    splice(model, "div", "Add", np.array([[0.5 / 160], [0.5 / 64]]))


def voxels_summed(model: onnx.ModelProto) -> None:
    """The number of cameras by which a sum is divided is always 1."""
    node = producer_of(model, "clamp")
    node.input[:] = [node.input[0], node.input[1], node.input[1]]


def _invert(model: onnx.ModelProto, name: str) -> None:
    """Negate a mask with operators that exported graphs also hold. The operator that is inserted last comes first."""
    splice(model, name, "Less", np.array(0.5, np.float32))
    splice(model, name, "Cast", to=onnx.TensorProto.FLOAT)


def _redirect(model: onnx.ModelProto, name: str, other: str) -> None:
    for node in model.graph.node:
        node.input[:] = [other if x == name else x for x in node.input]


def _replace(model: onnx.ModelProto, output: str, operator: str) -> None:
    """Replace the node that computes `output` by an operator with one input."""
    node = producer_of(model, output)
    node.op_type = operator
    del node.input[1:], node.attribute[:]
