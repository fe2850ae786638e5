"""Mistakes in calibrations: extrinsics, intrinsics and image sizes."""

from collections.abc import Callable

import numpy as np

from duospacenet.runtime.geometry import (
    CAMERA_R_BODY,
    inverse,
    quaternion_from_rotation,
    rigid_transform,
    rotation_from_quaternion,
    rotation_z,
)
from tests.rig.scene_mistake import Array, Injection, Mistake, Record, Rng, calibrations_of, random_pair

Change = Callable[[Array], Array]

OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])
INCH_M = 0.0254

INVERSE = "inverse of camera_T_ego"


def _change(field: str, change: Change, one: bool = False) -> Injection:
    def inject(record: Record, rng: Rng) -> list[str]:
        calibrations = calibrations_of(record)
        names = list(calibrations)
        if one:  # of the cameras that the change moves: some mistakes do not change a camera that looks straight ahead
            values = {name: np.array(calibrations[name][0][field], float) for name in sorted(names)}
            moved = [name for name in values if not np.allclose(change(values[name].copy()), values[name], atol=0.2)]
            names = [str(rng.choice(moved))]
        for name in names:
            for camera in calibrations[name]:
                camera[field] = np.asarray(change(np.array(camera[field], float))).tolist()
        return names

    return inject


def _all(change: Change) -> Injection:
    return _change("camera_T_ego", change)


def _one(change: Change) -> Injection:
    return _change("camera_T_ego", change, one=True)


def _translation(factor: float) -> Change:
    return lambda m: rigid_transform(m[:3, :3], m[:3, 3] * factor)


def _position_as_translation(m: Array) -> Array:
    return rigid_transform(m[:3, :3], inverse(m)[:3, 3])


def _rotation_transposed(m: Array) -> Array:
    return inverse(rigid_transform(m[:3, :3], inverse(m)[:3, 3]))


def _wrong_quaternion(order: tuple[int, ...]) -> Change:
    def change(m: Array) -> Array:
        quaternion = quaternion_from_rotation(m[:3, :3].T)[list(order)]
        return inverse(rigid_transform(rotation_from_quaternion(quaternion), inverse(m)[:3, 3]))

    return change


def _misread_angles(convert: Callable[[Array], Array]) -> Change:
    def change(m: Array) -> Array:
        ego_T_camera = inverse(m)
        angles = convert(_euler(ego_T_camera[:3, :3]))
        return inverse(rigid_transform(_from_euler(angles), ego_T_camera[:3, 3]))

    return change


def _euler(rotation: Array) -> Array:
    return np.array(
        [
            np.arctan2(rotation[2, 1], rotation[2, 2]),
            np.arcsin(-rotation[2, 0]),
            np.arctan2(rotation[1, 0], rotation[0, 0]),
        ]
    )


def _from_euler(angles: Array) -> Array:
    x, y, z = angles
    cx, sx, cy, sy = np.cos(x), np.sin(x), np.cos(y), np.sin(y)
    return (
        rotation_z(z)
        @ np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
        @ np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
    )


def _origin_above_cameras(low_m: float, high_m: float) -> Injection:
    def inject(record: Record, rng: Rng) -> list[str]:
        heights = [inverse(np.array(each[0]["camera_T_ego"]))[2, 3] for each in calibrations_of(record).values()]
        height = float(np.median(heights)) + rng.uniform(low_m, high_m)
        return _all(lambda m: m @ rigid_transform(np.eye(3), [0, 0, height]))(record, rng)

    return inject


def _exchange_centre(k: Array) -> Array:
    k[0, 2], k[1, 2] = k[1, 2], k[0, 2]
    return k


def _normalise(record: Record, rng: Rng) -> list[str]:
    for cameras in calibrations_of(record).values():
        for camera in cameras:
            scale = np.diag([1 / camera["width_px"], 1 / camera["height_px"], 1])
            camera["intrinsics_px"] = (scale @ np.array(camera["intrinsics_px"])).tolist()
    return list(calibrations_of(record))


def _exchange_calibrations(record: Record, rng: Rng) -> list[str]:
    calibrations = calibrations_of(record)
    one, other = random_pair(record, rng)
    for mine, theirs in zip(calibrations[one], calibrations[other], strict=True):
        for field in ("camera_T_ego", "intrinsics_px"):
            mine[field], theirs[field] = theirs[field], mine[field]
    return [one, other]


def _copy_calibration(record: Record, rng: Rng) -> list[str]:
    one, other = random_pair(record, rng)
    calibrations = calibrations_of(record)
    for mine, theirs in zip(calibrations[one], calibrations[other], strict=True):
        mine.update({key: theirs[key] for key in ("camera_T_ego", "intrinsics_px")})
    return [one, other]


def _half_size(record: Record, rng: Rng) -> list[str]:
    for cameras in calibrations_of(record).values():
        for camera in cameras:
            camera["width_px"], camera["height_px"] = camera["width_px"] // 2, camera["height_px"] // 2
            camera["intrinsics_px"] = (np.diag([0.5, 0.5, 1]) @ np.array(camera["intrinsics_px"])).tolist()
    return list(calibrations_of(record))


CALIBRATION_MISTAKES: dict[str, Mistake] = {
    "extrinsics inverted, all": Mistake(_all(inverse), INVERSE),
    "extrinsics inverted, one": Mistake(_one(inverse), INVERSE),
    "rotation transposed, all": Mistake(_all(_rotation_transposed), "rotation is transposed"),
    "rotation transposed, one": Mistake(_one(_rotation_transposed), "rotation is transposed"),
    "translation is the position, all": Mistake(_all(_position_as_translation), "camera's position"),
    "translation is the position, one": Mistake(_one(_position_as_translation), "camera's position"),
    "millimetres, all": Mistake(_all(_translation(1000)), "translation is in millimetres"),
    "millimetres, one": Mistake(_one(_translation(1000)), "translation is in millimetres"),
    "centimetres, all": Mistake(_all(_translation(100)), "translation is in centimetres"),
    "centimetres, one": Mistake(_one(_translation(100)), "translation is in centimetres"),
    "inches, all": Mistake(_all(_translation(1 / INCH_M)), "translation is in inches"),
    "inches, one": Mistake(_one(_translation(1 / INCH_M)), "translation is in inches"),
    "kilometres, all": Mistake(_all(_translation(0.001)), "translation is in kilometres"),
    "camera axes x forward, all": Mistake(
        _all(lambda m: rigid_transform(CAMERA_R_BODY.T, np.zeros(3)) @ m), "camera axes are x forward"
    ),
    "camera axes of OpenGL, all": Mistake(_all(lambda m: OPENGL @ m), "OpenGL"),
    "camera axes of OpenGL, one": Mistake(_one(lambda m: OPENGL @ m), "OpenGL"),
    "ego z down, all": Mistake(_all(lambda m: m @ OPENGL), "y to the right and z down"),
    "quaternion x y z w, all": Mistake(_all(_wrong_quaternion((1, 2, 3, 0))), "quaternion was read in the wrong order"),
    "quaternion w x y z, all": Mistake(_all(_wrong_quaternion((3, 0, 1, 2))), "quaternion was read in the wrong order"),
    "quaternion x y z w, one": Mistake(_one(_wrong_quaternion((1, 2, 3, 0))), "quaternion was read in the wrong order"),
    "degrees as radians, all": Mistake(_all(_misread_angles(np.degrees)), "degrees were read as radians"),
    "radians as degrees, all": Mistake(_all(_misread_angles(np.radians)), "radians were read as degrees"),
    "ego origin on the roof": Mistake(_origin_above_cameras(0.2, 0.8), "ego origin is|ego frame may be on the roof"),
    "ego origin at the cameras": Mistake(
        _origin_above_cameras(-0.05, 0.1), "ego origin is|ego frame may be on the roof"
    ),
    "cx and cy exchanged, all": Mistake(_change("intrinsics_px", _exchange_centre), "cx and cy are exchanged"),
    "cx and cy exchanged, one": Mistake(_change("intrinsics_px", _exchange_centre, True), "cx and cy are exchanged"),
    "intrinsics of half the size, all": Mistake(
        _change("intrinsics_px", lambda k: np.diag([0.5, 0.5, 1]) @ k), "another resolution"
    ),
    "intrinsics of double the size, one": Mistake(
        _change("intrinsics_px", lambda k: np.diag([2.0, 2, 1]) @ k, True), "another resolution"
    ),
    "intrinsics normalised, all": Mistake(_normalise, "normalised"),
    "intrinsics transposed, all": Mistake(_change("intrinsics_px", np.transpose), "matrix is transposed"),
    "whole matrix transposed, all": Mistake(_all(np.transpose), "whole matrix is transposed"),
    "left-handed, one": Mistake(_one(lambda m: np.diag([-1.0, 1, 1, 1]) @ m), "mirrored"),
    "no translation, all": Mistake(_all(_translation(0)), "translation is missing"),
    "two calibrations exchanged": Mistake(_exchange_calibrations, "are swapped|are exchanged", compares_images=True),
    "one calibration twice": Mistake(_copy_calibration, "have the same calibration"),
    "sizes of halved images": Mistake(_half_size, "scaled by 2"),
}
