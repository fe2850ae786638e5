"""The pictures of an examination: one a camera, with the ground as its calibration has it; and the map from above."""

import re
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from ..drawing.canvas import Colour, Picture
from ..drawing.coverage_map import GroundCoverage, Wedge, draw_coverage_map
from ..drawing.ground_view import draw_ground_view
from ..runtime.bundle.manifest import Preprocessing
from ..runtime.frame import Camera
from ..runtime.preprocessing import resize_transform
from .coverage import through
from .examination import CameraView, Examination
from .findings import Finding, Verdict
from .formatting import describe_azimuth, describe_elevation, describe_roll, describe_sectors
from .optics import field_of_view, pose, rays

Array = NDArray[np.float64]

VERDICT_COLOURS: dict[Verdict, Colour] = {
    Verdict.OK: (118, 230, 0),
    Verdict.SUSPECT: (60, 200, 255),
    Verdict.BROKEN: (90, 90, 255),
}
TEXT_COLOUR: Colour = (225, 225, 225)
LONGEST_NAME = 80  # of a file: names of cameras may be longer than a folder takes


def draw_camera_overlay(name: str, examination: Examination) -> Picture:
    """A camera's picture with grid, rings, axes and horizon, above its verdict and what was found."""
    view = examination.views[name]
    words = [(describe_view(view), VERDICT_COLOURS[view.verdict]), *map(_worded, view.findings)]
    preprocessing = examination.requirements.preprocessing
    cut = None if preprocessing is None else cut_corners(view.camera, preprocessing)
    return draw_ground_view(name, view.camera, view.photo.image, words, cut)


def draw_rig_coverage(examination: Examination) -> Picture:
    """The map of how many cameras see the road, with every camera's field of view."""
    perception, coverage = examination.requirements.perception, examination.coverage
    count = coverage.ground_count() if coverage.ground else np.zeros(perception.size[:2], np.int64)
    ground = GroundCoverage(count, perception.lower_m[:2], perception.upper_m[:2])
    words = [(describe_sectors(examination.blind_sectors), TEXT_COLOUR)]
    wedges = []
    for name, view in examination.views.items():
        if name in coverage.ground:
            wedges.append(wedge(name, through(view.camera, examination.requirements.preprocessing)))
        if view.verdict is not Verdict.OK:
            counted = "" if name in coverage.ground else ", not drawn and not counted"
            words.append((f"{name}: {view.verdict}{counted}", VERDICT_COLOURS[view.verdict]))
    return draw_coverage_map(ground, wedges, words)


def wedge(name: str, camera: Camera) -> Wedge:
    """A camera's field of view from above, between the rays through the middle of its left and right borders."""
    width, middle = camera.width_px, camera.height_px / 2
    pixels = np.array([(0, middle), (width / 2, middle), (width, middle)], dtype=np.float64)
    x, y, _ = (rays(camera, pixels) @ camera.camera_T_ego[:3, :3]).T
    left, centre, right = np.arctan2(y, x).tolist()
    return Wedge(name, pose(camera.camera_T_ego).position_m[:2], left, centre, right)


def cut_corners(camera: Camera, preprocessing: Preprocessing) -> Array:
    """The corners (4, 2) in a camera's pixels of what the network gets of its picture."""
    width, height = preprocessing.width_px, preprocessing.height_px
    corners = np.array([(0, 0, 1), (width, 0, 1), (width, height, 1), (0, height, 1)], dtype=np.float64)
    return np.asarray(np.linalg.solve(resize_transform(camera, preprocessing), corners.T)[:2].T, dtype=np.float64)


def overlay_paths(names: Iterable[str]) -> dict[str, str]:
    """`cameras/NAME.png` for every camera: what no safe file name holds becomes `_`, and equal names get a number."""
    paths: dict[str, str] = {}
    taken: set[str] = set()
    for name in names:
        stem = re.sub(r"[^A-Za-z0-9_-]", "_", name)[:LONGEST_NAME] or "_"
        free = next(each for each in _numbered(stem) if each.lower() not in taken)
        taken.add(free.lower())
        paths[name] = f"cameras/{free}.png"
    return paths


def describe_view(view: CameraView) -> str:
    """What a camera is said to be, in a line."""
    where, angles = pose(view.camera.camera_T_ego), field_of_view(view.camera)
    x, y, z = where.position_m
    return (
        f"{view.verdict}, frame {view.frame}: looks {describe_azimuth(where.azimuth_deg)}, "
        f"{describe_elevation(where.elevation_deg)}{describe_roll(where.roll_deg)}, from x {x:.2f}, "
        f"y {y:.2f}, z {z:.2f} m; sees {angles.horizontal:.1f} x {angles.vertical:.1f} degrees"
    )


def _worded(finding: Finding) -> tuple[str, Colour]:
    return str(finding), VERDICT_COLOURS[finding.verdict]


def _numbered(stem: str) -> Iterable[str]:
    yield stem
    number = 2
    while True:
        yield f"{stem}_{number}"
        number += 1
