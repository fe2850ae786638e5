"""The inputs of a request as a frame. They come from a network, so nothing about them is trusted."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from ...data.images import decode_image
from ...runtime import Camera, Frame
from ...runtime.errors import InputError
from ...runtime.printable import has_control_character, shortened
from ...runtime.validation import check_camera, check_frame_header

Arrays = Mapping[str, NDArray]
CAMERA_TENSORS = ("images", "size_px", "intrinsics_px", "camera_T_ego")


def read_frame(inputs: Arrays, num_cameras: int) -> Frame:
    """Return the frame of a request. Its images are decoded after everything else has been checked.

    inputs: by the names of `serving_tensors.INPUTS`. The server has checked their types and their numbers of axes.
    num_cameras: the largest number of cameras that the bundle accepts.
    Raises InputError, naming the tensor or the camera.
    """
    _check_lengths(inputs, num_cameras)
    names = _camera_names(inputs)
    cameras = {name: _camera(inputs, row) for row, name in enumerate(names)}
    frame = Frame(
        images=dict.fromkeys(names),
        cameras=cameras,
        global_T_ego=inputs["global_T_ego"],
        timestamp_s=float(inputs["timestamp_s"][0]),
        scene=_text("scene", inputs["scene"][0]) if "scene" in inputs else "",
    )
    check_frame_header(frame, num_cameras)
    for name, camera in cameras.items():
        check_camera(name, camera)
    images = {name: _image(name, inputs["images"][row], cameras[name]) for row, name in enumerate(names)}
    return Frame(images, cameras, frame.global_T_ego, frame.timestamp_s, frame.scene)


def _check_lengths(inputs: Arrays, num_cameras: int) -> None:
    """Check the number of cameras, and that each has one row in each tensor."""
    count = len(inputs["camera_names"])
    if not 1 <= count <= num_cameras:
        raise InputError(f"camera_names: expected 1 to {num_cameras} cameras; got {count}.")
    for tensor in CAMERA_TENSORS:
        if len(inputs[tensor]) != count:
            raise InputError(
                f"{tensor}: expected {count} rows, one for each of camera_names; got {len(inputs[tensor])}."
            )


def _camera_names(inputs: Arrays) -> list[str]:
    names = [_text("camera_names", name) for name in inputs["camera_names"]]
    if len(set(names)) < len(names):
        raise InputError(f"camera_names: expected different names; got {shortened(names)}.")
    return names


def _camera(inputs: Arrays, row: int) -> Camera:
    width_px, height_px = inputs["size_px"][row].tolist()
    return Camera(inputs["intrinsics_px"][row], inputs["camera_T_ego"][row], width_px, height_px)


def _image(name: str, data: bytes, camera: Camera) -> NDArray[np.uint8] | None:
    """Decode the image of a camera; None for a lost camera, which has no bytes."""
    return decode_image(data, f"camera {name}", camera.width_px, camera.height_px) if data else None


def _text(tensor: str, value: bytes) -> str:
    """Decode a text. A text with control characters is refused here, because messages contain the names."""
    try:
        text = value.decode()
    except UnicodeDecodeError:
        raise InputError(f"{tensor}: expected text in UTF-8; got {shortened(value)}.") from None
    if has_control_character(text):
        raise InputError(f"{tensor}: expected text without control characters; got {shortened(text)}. Rename it.")
    return text
