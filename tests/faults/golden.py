"""Golden cases: values computed by hand for the code that both sides of the parity check share.

An error in that code has the same effect on both sides, so parity cannot detect it.
A case takes a bundle of the tiny preset and raises AssertionError if it fails.
"""

import json
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import cv2
import numpy as np
import torch
from numpy.testing import assert_allclose, assert_array_equal
from torch import nn

from duospacenet.data import nuscenes_submission as nuscenes
from duospacenet.data import results
from duospacenet.model import PRESETS, attention, image_encoder, lifter, pose_vectors
from duospacenet.model.window import Window
from duospacenet.runtime import Camera, Detections, Frame, Pipeline, preprocessing
from duospacenet.runtime import geometry as runtime_geometry
from duospacenet.runtime.bundle.manifest import GraphSpec, Manifest, read_manifest
from duospacenet.runtime.detections import HistoryReport
from duospacenet.runtime.history import History, PastFrame
from duospacenet.runtime.session import Session, Tensors, to_tensors

TINY = PRESETS["tiny"]
CLASSES = """car truck construction_vehicle bus trailer barrier motorcycle bicycle pedestrian
traffic_cone"""  # the order of public checkpoints
LOOKING_AHEAD = np.array([[0, -1, 0], [0, 0, -1], [1, 0, 0.0]])  # right is -y, down is -z, depth is x
LOOKING_LEFT = np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0.0]])  # right is x, down is -z, depth is y
QUARTER_LEFT = np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1.0]])  # a rotation by 90 degrees counter-clockwise


def classes_have_the_published_order(bundle: Path) -> None:
    # Query q has its highest logit in column q: ln 3 = 1.0986 for q = 0, and 0.1 less for each further query.
    # All other logits are -9. So the detections have the classes in column order.
    # The first score is 1 / (1 + exp(-ln 3)) = 1 / (1 + 1 / 3) = 0.75.
    logits = np.full((TINY.num_queries, 10), -9, np.float32)
    logits[range(10), range(10)] = np.log(3) - 0.1 * np.arange(10)
    detections = _detect(bundle, class_logits=logits)
    assert list(detections.classes[:10]) == CLASSES.split()
    assert detections.queries[:10].tolist() == list(range(10))
    assert_allclose(detections.scores[0], 0.75, rtol=1e-6)


def a_pose_decodes_to_a_box(bundle: Path) -> None:
    # 𝒫 is x y z, log w l h, sin and cos of 30 degrees, vx vy; a box is x y z w l h yaw vx vy. 30 degrees are pi / 6.
    pose = [10, -4, 0.5, np.log(1.9), np.log(4.6), np.log(1.7), 0.5, 0.8660254, 3, -1]
    box = pose_vectors.decode_boxes(torch.tensor([pose], dtype=torch.float64))
    assert_allclose(box[0], [10, -4, 0.5, 1.9, 4.6, 1.7, np.pi / 6, 3, -1], rtol=1e-6)


def box_corners_follow_the_heading(bundle: Path) -> None:
    # The box is 2 m wide, 4 m long and 1.5 m high and heads along +y. Its front is at y + 2 m, its left at x - 1 m.
    corners = runtime_geometry.box_corners(np.array([10, -4, 0.5, 2, 4, 1.5, np.pi / 2, 0, 0]))[0]
    assert_allclose(corners[0], [9, -2, -0.25], atol=1e-12)  # front left, bottom
    assert_allclose(corners[6], [11, -6, 1.25], atol=1e-12)  # rear right, top


def a_submission_is_in_the_global_frame(bundle: Path) -> None:
    # The ego is at (100, 50) and heads along global y, so the ego vector (x, y) is (-y, x) in the global frame.
    # The box at (10, -4) is at (100 + 4, 50 + 10), and its velocity (3, -1) m/s is (1, 3).
    # Its yaw is 30 + 90 = 120 degrees, so the quaternion is (cos 60, 0, 0, sin 60).
    pose = runtime_geometry.rigid_transform(QUARTER_LEFT, [100, 50, 0])
    box = np.array([[10, -4, 0.5, 1.9, 4.6, 1.7, np.pi / 6, 3, -1]], np.float32)
    found = Detections(box, np.array([0.9], np.float32), ("car",), np.array([0]), HistoryReport(1), token="a")
    record = results.frame_result(Frame({}, {}, pose, 0.0, token="a"), found, {})
    with tempfile.TemporaryDirectory() as folder:
        nuscenes.write_submission(Path(folder) / "submission.json", [record])
        (written,) = json.loads((Path(folder) / "submission.json").read_text())["results"]["a"]
    assert_allclose(written["translation"], [104, 60, 0.5], rtol=1e-6)
    assert_allclose(written["size"], [1.9, 4.6, 1.7], rtol=1e-6)
    assert_allclose(written["rotation"], [0.5, 0, 0, 0.8660254], atol=1e-6)
    assert_allclose(written["velocity"], [1, 3], rtol=1e-6)


def a_red_pixel_is_normalised_as_red(bundle: Path) -> None:
    # The pixel is (0, 0, 255) in BGR. An RGB network gets (255 - 123.675) / 58.395, (0 - 116.28) / 57.12 and
    # (0 - 103.53) / 57.375. A caffe network gets BGR minus the mean: 0 - 103.939, 0 - 116.779, 255 - 123.68.
    red = torch.tensor([[[[0, 0, 255]]]], dtype=torch.uint8)
    caffe = replace(TINY, image=PRESETS["small"].image)
    for config, expected in ((TINY, [2.248908, -2.035714, -1.804444]), (caffe, [-103.939, -116.779, 131.32])):
        normalised = image_encoder.Normalisation(config.image)(red)
        assert_allclose(normalised[0, :, 0, 0], expected, rtol=1e-5)


def a_point_projects_to_its_pixel_after_resize_and_crop(bundle: Path) -> None:
    # The camera looks forward. It is 0.5 m in front of the ego origin and 1.5 m above it. The point at (10.5, -1, 1)
    # in the ego frame is 10 m in front of the camera, 1 m to its right and 0.5 m below it.
    # So u = 160 + 200 * 1 / 10 = 180 and v = 90 + 200 * 0.5 / 10 = 100.
    # The image of 320x180 is resized to 160x90, and 90 - 64 = 26 rows are cropped at the top: (90, 50 - 26) = (90, 24).
    # A block of 4x4 pixels around (180, 100) becomes rows 23 and 24, columns 89 and 90, still in BGR.
    image = np.zeros((180, 320, 3), np.uint8)
    image[98:102, 178:182] = (10, 20, 200)
    frame = _frame(_camera(LOOKING_AHEAD, [0.5, 0, 1.5]), image)
    images, projections, valid = preprocessing.prepare(frame, _settings(bundle), 6)
    pixels, depth_m = runtime_geometry.project(np.array([10.5, -1, 1]), projections[0].astype(np.float64))
    assert_allclose([*pixels, depth_m], [90, 24, 10], atol=1e-4)
    expected = np.zeros((64, 160, 3), np.uint8)
    expected[23:25, 89:91] = (10, 20, 200)
    assert_array_equal(images[0], expected)
    assert valid.tolist() == [True, False, False, False, False, False]


def a_pixel_is_the_mean_of_the_pixels_it_covers(bundle: Path) -> None:
    # Four pixels become one: (0 + 100 + 200 + 60) / 4 = 90. Rows 98 and 99 become row 49; minus the 26 cropped rows
    # this is row 23.
    image = np.zeros((180, 320, 3), np.uint8)
    image[98:100, 178:180] = np.array([[0, 100], [200, 60]])[..., None]
    images = preprocessing.prepare(_frame(_camera(LOOKING_AHEAD), image), _settings(bundle), 6).images
    assert_array_equal(images[0, 23, 89], [90, 90, 90])


def a_lost_camera_is_not_valid(bundle: Path) -> None:
    inputs = preprocessing.prepare(_frame(_camera(LOOKING_AHEAD), None), _settings(bundle), 6)
    assert not inputs.camera_valid.any()
    assert not inputs.images.any()


def a_camera_to_the_left_lifts_voxels_on_the_left(bundle: Path) -> None:
    # The grid has 16 cells of 6.4 m over [-51.2, 51.2] m, and 4 of 2 m over [-3, 5] m in height.
    # Cell (8, 11, 2) has its centre at x = 3.2, y = 22.4, z = 2. It is visible in one camera.
    # Its mirror image (8, 4, 2), at y = -22.4, is behind the camera. Cell (11, 8, 2), at x = 22.4 and y = 3.2, is
    # 82 degrees off the optical axis, outside the field of view of 90 degrees. y varies fastest, then x, then z.
    camera = _camera(LOOKING_LEFT, [0, 0, 1.5], size=(160, 64), focal_px=80)
    projection = runtime_geometry.image_T_ego(camera.intrinsics_px, camera.camera_T_ego)
    image_T_ego = torch.tensor(projection, dtype=torch.float32)[None]
    visible = lifter.Projector(TINY)(image_T_ego, torch.tensor([True])).voxel_visible[0]
    assert [bool(visible[(2 * 16 + x) * 16 + y]) for x, y in ((8, 11), (8, 4), (11, 8))] == [True, False, False]


def a_query_attends_to_its_own_bev_cell(bundle: Path) -> None:
    # The centre of cell (12, 3) is x = -51.2 + 6.4 * 12.5 = 28.8 and y = -51.2 + 6.4 * 3.5 = -28.8. Without offsets,
    # all sampling points of a query at this position are in exactly this cell. A query at the mirrored position samples
    # zeros.
    module = attention.BEVAttention(TINY)
    for part in (module.deformable.offsets, module.deformable.weights, module.deformable.output):
        nn.init.zeros_(part.weight)
        nn.init.zeros_(part.bias)
    nn.init.eye_(module.deformable.output.weight)
    bev = torch.zeros(1, TINY.channels, 16, 16)
    bev[..., 12, 3] = 1
    pose = torch.zeros(1, 2, 10)
    pose[0, :, :2] = torch.tensor([[28.8, -28.8], [-28.8, 28.8]])
    valid = torch.ones(1, dtype=torch.bool)
    with torch.no_grad():
        result = module(torch.zeros(1, 2, TINY.channels), pose, [bev], Window(*[valid] * 5))
    assert_allclose(result[0, :, 0], [1, 0], atol=1e-5)


def a_static_point_approaches_the_moving_ego(bundle: Path) -> None:
    # The ego was at global (100, 50) and headed along global y. In 0.5 s it moved 1 m forward, to (100, 51), and turned
    # left by 90 degrees, so that it heads along -x. A point at global (95, 51) was 1 m in front and 5 m to the left. It
    # is 5 m in front now. A point at (100, 60) was 10 m in front and is 9 m to the right now.
    then = runtime_geometry.rigid_transform(QUARTER_LEFT, [100, 50, 0])
    now = runtime_geometry.rigid_transform(np.diag([-1, -1, 1]), [100, 51, 0])
    window = _window(bundle, then, now, elapsed_s=0.5)
    past_T_now = window["past_T_now"].numpy()
    assert_allclose(past_T_now[1] @ [5, 0, 0, 1], [1, 5, 0, 1], atol=1e-5)
    assert_allclose(past_T_now[1] @ [0, -9, 0, 1], [10, 0, 0, 1], atol=1e-5)
    assert_array_equal(past_T_now[0], np.eye(4))
    assert_allclose(window["time_delta_s"].numpy(), [0, 0.5, 0, 0])
    assert window["frame_valid"].numpy().tolist() == [True, True, False, False]


def a_moving_object_was_farther_back(bundle: Path) -> None:
    # The object is 10 m in front and moves forward with 2 m/s, so it was at 9 m half a second ago. The transform
    # rotates by 90 degrees and moves by 1 m along x. So the position in the past frame is (0, 9) + (1, 0), the heading
    # is along y, and the velocity is (0, 2) m/s.
    pose = torch.tensor([[10, 0, 1, 0, 0, 0, 0, 1, 2, 0.0]])
    past_T_now = torch.tensor(runtime_geometry.rigid_transform(QUARTER_LEFT, [1, 0, 0]), dtype=torch.float32)[None]
    past = pose_vectors.compensate_motion(pose, past_T_now, torch.tensor([0.5]))
    assert_allclose(past[0, 0], [1, 9, 1, 0, 0, 0, 1, 0, 0, 2], atol=1e-6)


def a_map_cell_is_at_its_x_and_y(bundle: Path) -> None:
    # All logits are -9, except +9 in cell (12, 3), x first. Its probability is 1 / (1 + exp(-9)) = 0.99988, which is
    # 255 in the file.
    logits = np.full((1, 1, 16, 16), -9, np.float32)
    logits[0, 0, 12, 3] = 9
    maps = _detect(bundle, drivable_area=logits).maps
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "maps").mkdir()
        paths = results.write_masks(Path(folder), 0, maps)
        written = cv2.imread(str(Path(folder) / paths["drivable_area"]), cv2.IMREAD_GRAYSCALE)
    assert_allclose(maps["drivable_area"][12, 3], 0.99988, atol=1e-5)
    assert np.argwhere(written > 100).tolist() == [[12, 3]]
    assert written[12, 3] == 255


GOLDEN_CASES: tuple[Callable[[Path], None], ...] = (
    classes_have_the_published_order,
    a_pose_decodes_to_a_box,
    box_corners_follow_the_heading,
    a_submission_is_in_the_global_frame,
    a_red_pixel_is_normalised_as_red,
    a_point_projects_to_its_pixel_after_resize_and_crop,
    a_pixel_is_the_mean_of_the_pixels_it_covers,
    a_lost_camera_is_not_valid,
    a_camera_to_the_left_lifts_voxels_on_the_left,
    a_query_attends_to_its_own_bev_cell,
    a_static_point_approaches_the_moving_ego,
    a_moving_object_was_farther_back,
    a_map_cell_is_at_its_x_and_y,
)


# ---------------------------------------------------------------------------------------------------------------------
# Helpers


class _FixedOutputs:
    """A session that returns the given outputs, and zeros for all others."""

    def __init__(self, spec: GraphSpec, outputs: Mapping[str, np.ndarray]) -> None:
        self._outputs = {
            tensor.name: np.ascontiguousarray(outputs.get(tensor.name, np.zeros(tensor.shape, tensor.dtype)))
            for tensor in spec.outputs
        }

    def run(self, _inputs: Any) -> Tensors:
        return to_tensors(**self._outputs)


def _detect(bundle: Path, **outputs: np.ndarray) -> Detections:
    """The result of a stream of the bundle whose graphs return these outputs."""
    manifest = read_manifest(bundle)
    sessions = {name: cast("Session", _FixedOutputs(spec, outputs)) for name, spec in manifest.graphs.items()}
    return (
        Pipeline(manifest, sessions)
        .stream(maps=True)
        .step(_frame(_camera(LOOKING_AHEAD), np.zeros((180, 320, 3), np.uint8)))
    )


def _window(bundle: Path, then: np.ndarray, now: np.ndarray, elapsed_s: float) -> Tensors:
    manifest: Manifest = read_manifest(bundle)
    empty_memory = to_tensors(**{name: np.zeros(1, np.float32) for name in manifest.memory})
    calibration = np.zeros((6, 3, 4), np.float32), np.ones(6, np.bool_)
    past, current = [
        PastFrame("a", time_s, pose, *calibration, empty_memory)
        for time_s, pose in ((7.0, then), (7.0 + elapsed_s, now))
    ]
    return History(manifest, (past,)).decoder_inputs(current, empty_memory)[0]


def _settings(bundle: Path) -> Any:
    return read_manifest(bundle).preprocessing


def _camera(
    rotation: np.ndarray, position_m: Any = (0, 0, 0), size: tuple[int, int] = (320, 180), focal_px: float = 200
) -> Camera:
    """A camera at `position_m` in the ego frame, with its principal point in the middle of the image."""
    intrinsics = np.array([[focal_px, 0, size[0] / 2], [0, focal_px, size[1] / 2], [0, 0, 1.0]])
    camera_T_ego = np.eye(4)
    camera_T_ego[:3, :3], camera_T_ego[:3, 3] = rotation, -rotation @ np.array(position_m)
    return Camera(intrinsics, camera_T_ego, *size)


def _frame(camera: Camera, image: np.ndarray) -> Frame:
    return Frame({"front": image}, {"front": camera}, np.eye(4), 0.0)
