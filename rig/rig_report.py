"""Converts the examination of a rig to JSON values, the content of `rig.json`."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from .coverage import nearest_ground_m
from .diagnoses import group_findings
from .examination import CameraView, Examination
from .optics import camera_pose, field_of_view, orthonormality_error, principal_point_fraction

SCHEMA_VERSION = 1
DECIMALS = 9


def rig_report_dict(source: str, examination: Examination, pictures: Mapping[str, str]) -> dict[str, Any]:
    """All numbers, verdicts and findings of an examination. NaN and infinity become None.

    source: as given on the command line.
    pictures: path of the picture of each camera, relative to rig.json.
    """
    requirements = examination.requirements
    network_input = requirements.preprocessing
    return _to_json(
        {
            "schema_version": SCHEMA_VERSION,
            "source": source,
            "verdict": examination.verdict,
            "voxels": requirements.perception.model_dump(mode="json"),
            "seen_through": None
            if network_input is None
            else {"width_px": network_input.width_px, "height_px": network_input.height_px},
            "cameras": {name: _camera(name, examination, pictures[name]) for name in examination.views},
            "rig": {
                "counted": list(examination.coverage.voxels),
                "voxels_seen_by": examination.coverage.shares_by_count() if examination.coverage.voxels else None,
                "blind_sectors_deg": examination.blind_sectors,
            },
            "drive": _motion(examination),
            "ground_truth": {
                "verdict": examination.box_verdict,
                "findings": [finding.to_dict() for finding in examination.box_findings],
            },
            "diagnoses": [
                {"cameras": diagnosis.cameras, **diagnosis.finding.to_dict()}
                for diagnosis in group_findings({name: view.findings for name, view in examination.views.items()})
            ],
            "not_judged": [each.to_dict() for each in examination.not_judged],
            "looked_at": [
                {"frame": frame, "cameras": {name: size._asdict() for name, size in sizes.items()}}
                for frame, sizes in examination.image_sizes.items()
            ],
        }
    )


def _camera(name: str, examination: Examination, picture: str) -> dict[str, Any]:
    view = examination.views[name]
    return {
        "verdict": view.verdict,
        "findings": [finding.to_dict() for finding in view.findings],
        "frame": view.frame,
        "picture": picture,
        "calibrations": view.num_calibrations,
        **_calibration(view),
        "coverage": _coverage(name, examination),
    }


def _calibration(view: CameraView) -> dict[str, Any]:
    """The calibration of a camera and quantities derived from it."""
    camera = view.camera
    pose = camera_pose(camera.camera_T_ego)
    rotation = camera.camera_T_ego[:3, :3]
    with np.errstate(all="ignore"):
        return {
            "size_px": [camera.width_px, camera.height_px],
            "image_px": view.camera_image.size_px,
            "intrinsics_px": camera.intrinsics_px,
            "camera_T_ego": camera.camera_T_ego,
            "orthonormality_error": orthonormality_error(rotation),
            "determinant": np.linalg.det(rotation),
            "last_row_intrinsics": camera.intrinsics_px[2],
            "last_row_extrinsics": camera.camera_T_ego[3],
            "field_of_view_deg": field_of_view(camera)._asdict(),
            "principal_point_share": principal_point_fraction(camera),
            "fx_over_fy": np.divide(camera.intrinsics_px[0, 0], camera.intrinsics_px[1, 1]),
            "position_m": pose.position_m,
            "azimuth_deg": pose.azimuth_deg,
            "elevation_deg": pose.elevation_deg,
            "roll_deg": pose.roll_deg,
        }


def _coverage(name: str, examination: Examination) -> dict[str, Any] | None:
    """The coverage of a camera; None if its calibration is broken."""
    coverage = examination.coverage
    if name not in coverage.voxels:
        return None
    camera = examination.views[name].camera
    return {
        "voxels_seen": coverage.voxel_share(name),
        "voxels_seen_alone": coverage.exclusive_share(name),
        "ground_seen": coverage.ground_share(name),
        "nearest_ground_m": nearest_ground_m(camera, examination.requirements.preprocessing),
        "overlap": {other: coverage.overlap(name, other) for other in coverage.voxels if other != name},
    }


def _motion(examination: Examination) -> dict[str, Any]:
    steps = examination.steps
    return {
        "verdict": examination.motion_verdict,
        "findings": [finding.to_dict() for finding in examination.motion_findings],
        "frames": examination.num_frames,
        "median_step_s": np.median([step.elapsed_s for step in steps]) if steps else None,
        "median_speed_m_s": np.median([step.speed_m_s for step in steps]) if steps else None,
    }


def _to_json(value: Any) -> Any:
    """Convert to values of strict JSON: rounded floats, None for NaN and infinity, lists for arrays."""
    if isinstance(value, Mapping):
        return {str(key): _to_json(each) for key, each in value.items()}
    if isinstance(value, np.ndarray):
        return _to_json(value.tolist())
    if isinstance(value, (list, tuple)):
        return [_to_json(each) for each in value]
    if isinstance(value, (float, np.floating)):
        return round(float(value), DECIMALS) if np.isfinite(value) else None
    return value
