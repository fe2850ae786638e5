"""The inputs and outputs of the model on a server: one frame of one vehicle in, its detections out."""

from typing import NamedTuple

from ...runtime.bundle.manifest import Manifest

START, END = "START", "END"  # the control inputs of a sequence
ANY = -1  # the length of an axis that differs between requests


class ServingTensor(NamedTuple):
    """A tensor of a request or a response.

    dtype: Triton's name of the type. TYPE_STRING is a sequence of bytes.
    dims: length of each axis, `ANY` where it differs between requests.
    meaning: for the README.
    """

    name: str
    dtype: str
    dims: tuple[int, ...]
    meaning: str
    optional: bool = False


INPUTS = (
    ServingTensor("timestamp_s", "TYPE_FP64", (1,), "time of the frame, in seconds"),
    ServingTensor("global_T_ego", "TYPE_FP64", (4, 4), "ego pose at this time, in any fixed global frame"),
    ServingTensor("camera_names", "TYPE_STRING", (ANY,), "the N cameras of the rig, in UTF-8"),
    ServingTensor("images", "TYPE_STRING", (ANY,), "content of N JPEG or PNG files; no bytes for a lost camera"),
    ServingTensor("size_px", "TYPE_INT32", (ANY, 2), "width and height of the images, lost ones too"),
    ServingTensor("intrinsics_px", "TYPE_FP64", (ANY, 3, 3), "intrinsics, in pixels of these images"),
    ServingTensor("camera_T_ego", "TYPE_FP64", (ANY, 4, 4), "extrinsics at the time of the frame"),
    ServingTensor("scene", "TYPE_STRING", (1,), "name of the scene; another name resets the history", optional=True),
)


def serving_outputs(manifest: Manifest) -> tuple[ServingTensor, ...]:
    """Return the outputs for a bundle: D detections, highest score first, and what is known about the frame."""
    boxes = (
        ServingTensor("boxes", "TYPE_FP32", (ANY, 9), "x y z w l h [m], yaw [rad], vx vy [m/s], in the ego frame"),
        ServingTensor("scores", "TYPE_FP32", (ANY,), "from 0 to 1, highest first"),
        ServingTensor("class_ids", "TYPE_INT32", (ANY,), "index into the list of classes below"),
        ServingTensor("attributes", "TYPE_STRING", (ANY,), "nuScenes attribute, or empty for a class without any"),
        ServingTensor("history_frames", "TYPE_INT32", (1,), "frames that were used, this one included; 0 if skipped"),
        ServingTensor("reset_reason", "TYPE_STRING", (1,), "why the history was reset before this frame, or empty"),
        ServingTensor("skipped", "TYPE_STRING", (1,), "why the frame was skipped (lost cameras), or empty"),
        ServingTensor("dropped", "TYPE_INT32", (2,), "queries and map cells that were not finite, normally 0"),
    )
    if not manifest.map_classes:
        return boxes
    cells = manifest.perception.size[:2]
    meaning = f"probabilities of {', '.join(manifest.map_classes)} by cell; no maps for a skipped frame"
    return (*boxes, ServingTensor("maps", "TYPE_FP32", (ANY, *cells), meaning))
