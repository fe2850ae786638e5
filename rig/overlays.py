"""Pictures of an examination: each camera's image with the ground grid, and the coverage map from above."""

import re
from collections.abc import Iterable, Iterator
from itertools import count

import numpy as np
from numpy.typing import NDArray

from ..drawing.canvas import Colour, Picture
from ..drawing.coverage_map import GroundCoverage, Wedge, draw_coverage_map
from ..drawing.ground_view import draw_ground_view
from ..runtime.bundle.preprocessing_record import Preprocessing
from ..runtime.frame import Camera
from ..runtime.preprocessing import resize_transform
from .coverage import preprocessed_camera
from .examination import CameraView, Examination
from .findings import Finding, Verdict
from .formatting import describe_azimuth, describe_elevation, describe_position, describe_roll, describe_sectors
from .optics import camera_pose, field_of_view, pixel_rays

Array = NDArray[np.float64]

VERDICT_COLOURS: dict[Verdict, Colour] = {
    Verdict.OK: (118, 230, 0),
    Verdict.NOT_JUDGED: (225, 225, 225),
    Verdict.SUSPECT: (60, 200, 255),
    Verdict.BROKEN: (90, 90, 255),
}
NOTE_COLOUR: Colour = (225, 225, 225)
LONGEST_STEM = 80  # of a file name: file systems limit names to 255 bytes, camera names have no limit


def draw_camera_overlay(name: str, examination: Examination) -> Picture:
    """Draw a camera's image with ground grid, rings, axes and horizon, and below it its verdict and findings."""
    view = examination.views[name]
    notes = [(describe_view(view), VERDICT_COLOURS[view.verdict]), *map(_note, view.findings)]
    preprocessing = examination.requirements.preprocessing
    crop = None if preprocessing is None else crop_corners(view.camera, preprocessing)
    return draw_ground_view(name, view.camera, view.camera_image.image, notes, crop)


def draw_rig_coverage(examination: Examination) -> Picture:
    """Draw a map of the number of cameras that see each ground cell, with the field of view of each camera."""
    perception, coverage = examination.requirements.perception, examination.coverage
    counts = coverage.ground_count() if coverage.ground else np.zeros(perception.size[:2], np.int64)
    ground = GroundCoverage(counts, perception.lower_m[:2], perception.upper_m[:2])
    notes = [(describe_sectors(examination.blind_sectors), NOTE_COLOUR)]
    wedges = []
    for name, view in examination.views.items():
        if name in coverage.ground:
            camera = preprocessed_camera(view.camera, examination.requirements.preprocessing)
            wedges.append(field_of_view_wedge(name, camera))
        if view.verdict is not Verdict.OK:
            suffix = "" if name in coverage.ground else ", not on the map"
            notes.append((f"{name}: {view.verdict}{suffix}", VERDICT_COLOURS[view.verdict]))
    return draw_coverage_map(ground, wedges, notes)


def field_of_view_wedge(name: str, camera: Camera) -> Wedge:
    """A camera's field of view from above, between the rays through the middles of the left and right borders."""
    width, middle = camera.width_px, camera.height_px / 2
    pixels = np.array([(0, middle), (width / 2, middle), (width, middle)], dtype=np.float64)
    x, y, _ = (pixel_rays(camera, pixels) @ camera.camera_T_ego[:3, :3]).T
    left, centre, right = np.arctan2(y, x).tolist()
    return Wedge(name, camera_pose(camera.camera_T_ego).position_m[:2], left, centre, right)


def crop_corners(camera: Camera, preprocessing: Preprocessing) -> Array:
    """The corners (4, 2) [px] of the part of a camera's image that remains after preprocessing."""
    width, height = preprocessing.width_px, preprocessing.height_px
    corners = np.array([(0, 0, 1), (width, 0, 1), (width, height, 1), (0, height, 1)], dtype=np.float64)
    return np.asarray(np.linalg.solve(resize_transform(camera, preprocessing), corners.T)[:2].T, dtype=np.float64)


def overlay_paths(names: Iterable[str]) -> dict[str, str]:
    """The path `cameras/NAME.png` of each camera's picture.

    Characters other than letters, digits, `_` and `-` become `_`. Equal file names get a number. Upper and lower case
    count as equal, because some file systems do not distinguish them.
    """
    paths: dict[str, str] = {}
    used: set[str] = set()
    for name in names:
        stem = re.sub(r"[^A-Za-z0-9_-]", "_", name)[:LONGEST_STEM] or "_"
        unused = next(each for each in _numbered(stem) if each.lower() not in used)
        used.add(unused.lower())
        paths[name] = f"cameras/{unused}.png"
    return paths


def describe_view(view: CameraView) -> str:
    """One line with a camera's verdict, frame, direction, position and field of view."""
    pose, angles = camera_pose(view.camera.camera_T_ego), field_of_view(view.camera)
    return (
        f"{view.verdict}, frame {view.frame}: looks {describe_azimuth(pose.azimuth_deg)}, "
        f"{describe_elevation(pose.elevation_deg)}{describe_roll(pose.roll_deg)}, from "
        f"{describe_position(pose.position_m)}; field of view {angles.horizontal:.1f} x {angles.vertical:.1f} degrees"
    )


def _note(finding: Finding) -> tuple[str, Colour]:
    return str(finding), VERDICT_COLOURS[finding.verdict]


def _numbered(stem: str) -> Iterator[str]:
    """stem, stem_2, stem_3, ..."""
    yield stem
    for number in count(2):
        yield f"{stem}_{number}"
