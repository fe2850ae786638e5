"""Scene folders with JPEG files that are decoded at a reduced size."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from duospacenet.data.images import write_png
from duospacenet.data.scene_folder import SceneFolder
from duospacenet.runtime.bundle.preprocessing_record import Normalisation, Preprocessing
from duospacenet.runtime.errors import InputError
from duospacenet.runtime.preprocessing import prepare
from duospacenet.runtime.validation import check_frame
from duospacenet.synthetic.drive import SyntheticDrive
from tests.helpers.scene_files import edit_scene, front_image, write_jpeg_scene
from tests.helpers.scene_folders import assert_frames_equal

TO_80X40 = Preprocessing(
    width_px=80,
    height_px=40,
    colour_order="bgr",
    resize_shrinking="area by halvings",
    resize_enlarging="linear",
    crop="centre columns, bottom rows",
    normalisation_in_graph=Normalisation(colour_order="rgb", mean=(0, 0, 0), std=(1, 1, 1)),
)


@pytest.fixture
def folder(tmp_path):
    """A frame of 320x208 px images, which `TO_80X40` scales to a quarter. The back camera is lost."""
    frame = SyntheticDrive(3, 1, (320, 208)).frame(0)
    frame = replace(frame, images={**frame.images, "CAM_BACK": None})
    return write_jpeg_scene(tmp_path / "scene", [frame])


def test_jpeg_files_are_decoded_at_a_quarter_and_the_cameras_describe_the_smaller_images(folder):
    source = SceneFolder(folder)
    whole, reduced = source.frame(0), source.with_fast_decoding(TO_80X40).frame(0)
    camera, full = reduced.cameras["CAM_FRONT"], whole.cameras["CAM_FRONT"]
    assert reduced.images["CAM_FRONT"].shape == (52, 80, 3)
    assert (camera.width_px, camera.height_px) == (80, 52)
    np.testing.assert_array_equal(camera.intrinsics_px[:2], full.intrinsics_px[:2] / 4)
    np.testing.assert_array_equal(camera.intrinsics_px[2], [0, 0, 1])
    np.testing.assert_array_equal(camera.camera_T_ego, full.camera_T_ego)
    check_frame(reduced, 6)
    expected = cv2.imread(str(front_image(folder)), cv2.IMREAD_REDUCED_COLOR_4)
    assert np.array_equal(reduced.images["CAM_FRONT"], expected)


def test_the_network_gets_the_same_projections_and_nearly_the_same_images(folder):
    source = SceneFolder(folder)
    whole = prepare(source.frame(0), TO_80X40, 6)
    reduced = prepare(source.with_fast_decoding(TO_80X40).frame(0), TO_80X40, 6)
    assert np.array_equal(whole.image_T_ego, reduced.image_T_ego)
    assert np.array_equal(whole.camera_valid, reduced.camera_valid)
    assert np.abs(whole.images.astype(int) - reduced.images).mean() < 2
    assert not np.array_equal(whole.images, reduced.images)


def test_png_files_and_lost_cameras_are_not_reduced_and_the_source_is_not_changed(folder):
    path = front_image(folder)
    image = cv2.imread(str(path))
    write_png(path.with_suffix(".png"), image)
    edit_scene(
        folder,
        lambda scene: scene["frames"][0]["cameras"]["CAM_FRONT"].update(image=f"images/CAM_FRONT/{path.stem}.png"),
    )
    source = SceneFolder(folder)
    before = source.frame(0)
    reduced = source.with_fast_decoding(TO_80X40).frame(0)
    assert np.array_equal(reduced.images["CAM_FRONT"], image)
    assert reduced.images["CAM_BACK"] is None
    assert reduced.cameras["CAM_BACK"].width_px == reduced.cameras["CAM_FRONT"].width_px == 320
    assert reduced.cameras["CAM_BACK_LEFT"].width_px == 80
    assert_frames_equal(source.frame(0), before)


def test_damage_is_still_refused_with_the_path(folder):
    path = front_image(folder)
    data = path.read_bytes()
    path.write_bytes(data[: len(data) // 2])
    with pytest.raises(InputError, match=f"{path.name}: expected an undamaged image"):
        SceneFolder(folder).with_fast_decoding(TO_80X40).frame(0)
