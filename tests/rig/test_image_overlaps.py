"""Overlaps of images: distant points agree with the right calibrations, and with no others."""

import numpy as np
import pytest

from duospacenet.rig.findings import Verdict
from duospacenet.rig.image_directions import ImageDirections
from duospacenet.rig.image_features import Features
from duospacenet.rig.image_motion import ImageMotion
from duospacenet.rig.image_overlaps import ImageOverlaps
from duospacenet.runtime.geometry import image_T_ego, project
from tests.helpers.rigs import HEIGHT_PX, WIDTH_PX, level_camera, mount_position

AZIMUTHS_DEG = {"FRONT": 0, "LEFT": 75, "BACK_LEFT": 150, "BACK_RIGHT": -150, "RIGHT": -75}  # 15 degrees of overlap
CAMERAS = {name: level_camera(azimuth, mount_position(azimuth)) for name, azimuth in AZIMUTHS_DEG.items()}
RNG = np.random.default_rng(0)
DIRECTIONS = RNG.uniform(-np.pi, np.pi, 1500)
POINTS_M = np.stack([60 * np.cos(DIRECTIONS), 60 * np.sin(DIRECTIONS), RNG.uniform(0, 20, 1500)], axis=1)
DESCRIPTORS = RNG.normal(size=(1500, 128)).astype(np.float32)
DESCRIPTORS /= np.linalg.norm(DESCRIPTORS, axis=1, keepdims=True)


def features_of(taken_by, cameras=CAMERAS):
    """taken_by: for the image of each camera, the camera that takes it."""
    found = {}
    for name, other in taken_by.items():
        camera = cameras[other]
        pixels, depth_m = project(POINTS_M, image_T_ego(camera.intrinsics_px, camera.camera_T_ego))
        seen = (depth_m > 1) & (pixels >= 0).all(axis=1) & (pixels < (WIDTH_PX, HEIGHT_PX)).all(axis=1)
        found[name] = Features(pixels[seen], DESCRIPTORS[seen])
    return found


def findings(calibrations, taken_by=None, cameras=CAMERAS):
    overlaps = ImageOverlaps()
    overlaps.add(calibrations, features_of(taken_by or {name: name for name in cameras}, cameras))
    return list(ImageDirections(overlaps, ImageMotion(), cameras).camera_findings())


def test_right_calibrations_have_no_finding_and_agree_with_their_neighbours():
    overlaps = ImageOverlaps()
    overlaps.add(CAMERAS, features_of({name: name for name in CAMERAS}))
    assert overlaps.num_agreeing_pair(("FRONT", "LEFT")) > 20
    assert overlaps.num_agreeing_pair(("FRONT", "LEFT")) == overlaps.num_agreeing_pair(("LEFT", "FRONT"))
    assert overlaps.num_agreeing_pair(("FRONT", "BACK_LEFT")) == 0
    assert findings(CAMERAS) == []


def test_a_turned_camera_is_named_with_the_angle_and_the_side():
    turned = CAMERAS | {"LEFT": level_camera(95, mount_position(75))}  # 20 degrees too far to the left
    ((name, finding),) = findings(turned)
    assert (name, finding.verdict) == ("LEFT", Verdict.SUSPECT)
    assert "20 degrees more to the right" in finding.got
    assert "wrong by about 20 degrees" in finding.cause


def test_exchanged_images_are_found_for_both_cameras_only():
    taken_by = {name: name for name in CAMERAS} | {"LEFT": "RIGHT", "RIGHT": "LEFT"}
    found = findings(CAMERAS, taken_by)
    assert sorted(name for name, _ in found) == ["LEFT", "RIGHT"]
    assert all("exchanged" in finding.cause for _, finding in found)


@pytest.mark.parametrize("pair", [("60", "-60"), ("120", "-120"), ("0", "60")])
def test_no_other_pair_is_named_beside_the_exchanged_one(pair):
    """With 60 and -60 exchanged, an exchange of their neighbours 0 and 120 would fit the wrong calibrations, too."""
    ring = {f"{azimuth}": level_camera(azimuth, mount_position(azimuth)) for azimuth in (0, 60, 120, -120, -60)}
    taken_by = {name: name for name in ring} | dict(zip(pair, pair[::-1], strict=True))
    found = findings(ring, taken_by, ring)
    assert [(name, finding.subject) for name, finding in found] == [
        (pair[0], f"image compared with {pair[1]}"),
        (pair[1], f"image compared with {pair[0]}"),
    ]


def test_cameras_without_common_details_are_not_judged():
    overlaps = ImageOverlaps()
    overlaps.add(CAMERAS, {})
    (not_judged,) = ImageDirections(overlaps, ImageMotion(), CAMERAS).not_judged()
    assert not_judged.cameras == tuple(CAMERAS)
