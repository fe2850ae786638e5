"""Bundles with several faults at once. An earlier parity check called both of them equal to eager mode."""

from pathlib import Path

import numpy as np
import onnx

from duospacenet.runtime.bundle.manifest import read_manifest
from tests.helpers.bundles import edit_graph, edit_manifest

from .tensor_edits import remap

LOST_CAMERAS = [1, 4, 5]
LATE_SLOTS = [2, 3]


def masks_motion_and_classes(bundle: Path) -> None:
    """Cameras 1, 4 and 5 always count as valid, and in slots 2 and 3 every camera does.

    The decoder ignores pitch, roll and height of the ego motion, and the manifest lists the classes in reversed order.
    """
    manifest = read_manifest(bundle)
    shapes = {spec.name: spec.shape for spec in manifest.graphs["decoder"].inputs}
    num_cameras = manifest.num_cameras

    def in_projector(model: onnx.ModelProto) -> None:
        index = np.arange(num_cameras)
        index[LOST_CAMERAS] = index.size
        remap(model, "camera_valid", (num_cameras,), index, np.array([True]))

    def in_decoder(model: onnx.ModelProto) -> None:
        index = np.arange(np.prod(shapes["camera_valid"])).reshape(shapes["camera_valid"])
        index[:, LOST_CAMERAS] = index[LATE_SLOTS] = index.size
        remap(model, "camera_valid", shapes["camera_valid"], index, np.array([True]))
        remap(model, "past_T_now", shapes["past_T_now"], _planar(shapes["past_T_now"]), np.array([0, 1], np.float32))

    edit_graph(bundle, "projector", in_projector)
    edit_graph(bundle, "decoder", in_decoder)
    edit_manifest(bundle, lambda manifest: manifest["classes"].reverse())


def window_of_one_frame(bundle: Path) -> None:
    """The manifest has a perception range of 5 m, and limits that reset the history at every frame."""

    def change(manifest: dict) -> None:
        manifest["perception"].update(lower_m=[-5, -5, -3], upper_m=[5, 5, 5])
        manifest["window"].update(largest_speed_m_s=0.01, largest_time_delta_s=0.6)

    edit_manifest(bundle, change)


def _planar(shape: tuple[int, ...]) -> np.ndarray:
    """The sources of `past_T_now` without pitch, roll and height: zeros, and a one for z."""
    index = np.arange(np.prod(shape)).reshape(shape)
    zero, one = index.size, index.size + 1
    index[:, :2, 2] = index[:, 2, :2] = index[:, 2, 3] = zero
    index[:, 2, 2] = one
    return index
