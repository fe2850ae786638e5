"""Faults that parity cannot detect: both sides have the same error, or neither side runs the code."""

from collections.abc import Callable
from typing import Any

import numpy as np
import onnx
import torch
from torch import Tensor

from duospacenet.data import results, submitted_boxes
from duospacenet.export import graphs
from duospacenet.export.parity import reference, stress_sequence
from duospacenet.model import attention, decoder, image_encoder, lifter, pose_vectors
from duospacenet.runtime import detections, history, pipeline, preprocessing
from duospacenet.runtime import geometry as runtime_geometry
from duospacenet.runtime.parity import frame_error

from . import bundle_faults, stream_faults
from .bench import Bench, Prepare, splice


def in_shared_preparation(broken: Callable[[Prepare], Prepare]) -> Callable[[Bench], None]:
    """A fault in the preprocessing that the reference and the stream share."""
    return lambda bench: bench.change_shared_preparation(broken)


def extrinsics_transposed(bench: Bench) -> None:
    in_shared_preparation(stream_faults.with_changed_frame(stream_faults.extrinsic_transposed))(bench)


def in_boxes(columns: list[int], signs: list[int] | None = None) -> Callable[[Bench], None]:
    """A fault that reorders the columns of the boxes, in eager mode and in the graph.

    signs: a factor per column.
    """

    def inject(bench: Bench) -> None:
        decode, factors = pose_vectors.decode_boxes, signs or [1] * 9

        def broken(pose: Tensor) -> Tensor:
            # By column, and not with a tensor of indices: the comparison of weights runs this on the meta device.
            boxes = decode(pose)
            return torch.stack([boxes[..., c] * s for c, s in zip(columns, factors, strict=True)], dim=-1)

        def change(model: onnx.ModelProto) -> None:
            splice(model, "boxes", "Gather", np.array(columns), axis=1)
            splice(model, "boxes", "Mul", np.array(factors, np.float32))

        bench.patch("decode_boxes", broken, pose_vectors, graphs)
        bench.edit_graph("decoder", change)

    return inject


def rgb_for_bgr(bench: Bench) -> None:
    forward = image_encoder.Normalisation.forward
    bench.patch("forward", lambda self, images: forward(self, images.flip(-1)), image_encoder.Normalisation)
    bench.edit_graph("backbone", bundle_faults.rgb_for_bgr)


def mean_not_subtracted(bench: Bench) -> None:
    def forward(self: image_encoder.Normalisation, images: Tensor) -> Tensor:
        pixels = images.float().flip(-1) if self.flip_colours else images.float()
        return (pixels / self.std).permute(0, 3, 1, 2)

    bench.patch("forward", forward, image_encoder.Normalisation)
    bench.edit_graph("backbone", bundle_faults.subtraction_left_out)


def time_negated(bench: Bench) -> None:
    """Past positions are computed with the negative time difference."""
    compensate = pose_vectors.compensate_motion
    broken = lambda pose, past_T_now, time_delta_s: compensate(pose, past_T_now, -time_delta_s)  # noqa: E731
    bench.patch("compensate_motion", broken, pose_vectors, decoder)
    bench.edit_graph("decoder", lambda model: splice(model, "time_delta_s", "Mul", np.array(-1, np.float32)))


def velocity_not_rotated(bench: Bench) -> None:
    compensate = pose_vectors.compensate_motion

    def broken(pose: Tensor, *window: Tensor) -> Tensor:
        past = compensate(pose, *window)
        return torch.cat((past[..., :8], pose[None, :, 8:].expand(len(past), -1, -1)), dim=-1)

    bench.patch("compensate_motion", broken, pose_vectors, decoder)
    bench.edit_graph("decoder", lambda graph: bundle_faults.velocity_not_rotated(graph, num_layers=2))


def ego_motion_inverted(bench: Bench) -> None:
    """`inverse` returns its argument. The history and the reference both call it."""
    bench.patch("inverse", lambda a_T_b: a_T_b, runtime_geometry, history, reference, stress_sequence)


def voxels_transposed(bench: Bench) -> None:
    """The projector exchanges x and y of the voxels: it exchanges these columns of the calibration."""
    project_grid, columns = lifter.project_grid, [1, 0, 2, 3]

    def broken(axes: Any, image_T_ego: Tensor, *size_px: int) -> tuple[Tensor, Tensor]:
        return project_grid(axes, image_T_ego[..., columns], *size_px)

    bench.patch("project_grid", broken, lifter)
    bench.edit_graph("projector", lambda model: splice(model, "image_T_ego", "Gather", np.array(columns), axis=2))


def bev_queries_transposed(bench: Bench) -> None:
    """A query samples the BEV features around (x, y) instead of (y, x)."""
    locations = attention.bev_locations
    bench.patch("bev_locations", lambda points, voxels: locations(points, voxels).flip(-1), attention)
    bench.edit_graph("decoder", bundle_faults.x_and_y_swapped_in_bev)


def scores_of_half_the_logits(bench: Bench) -> None:
    sigmoid = detections.sigmoid
    bench.patch("sigmoid", lambda logits: sigmoid(logits / 2), detections, pipeline, frame_error)


def ascending_scores(bench: Bench) -> None:
    select_detections = detections.select_detections

    def broken(*arguments: Any) -> Any:
        queries, labels, scores, dropped = select_detections(*arguments)
        return queries[::-1], labels[::-1], scores[::-1], dropped

    bench.patch("select_detections", broken, detections, pipeline, frame_error)


# ---------------------------------------------------------------------------------------------------------------------
# Code that parity does not run


def box_corners_exchanged(bench: Bench) -> None:
    corners = runtime_geometry.box_corners
    swapped = [0, 1, 2, 4, 3, 5, 6, 7, 8]
    bench.patch("box_corners", lambda boxes: corners(np.reshape(boxes, (-1, 9))[:, swapped]), runtime_geometry)


def quaternion_with_w_last(bench: Bench) -> None:
    original = submitted_boxes.quaternion_from_rotation
    bench.patch("quaternion_from_rotation", lambda rotation: np.roll(original(rotation), -1), submitted_boxes)


def masks_transposed(bench: Bench) -> None:
    write = results.write_masks
    broken = lambda out, index, maps: write(out, index, {name: mask.T for name, mask in maps.items()})  # noqa: E731
    bench.patch("write_masks", broken, results)


def nearest_resize_kernel(bench: Bench) -> None:
    bench.patch("INTER_AREA", preprocessing.cv2.INTER_NEAREST, preprocessing.cv2)
