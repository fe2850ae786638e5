"""A catalogue of mistakes in scene folders, each with the diagnosis that `check-rig` must give.

Angles, cameras and amounts come from a random generator, so that no check fits a single value.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from duospacenet.runtime.geometry import (
    CAMERA_R_BODY,
    inverse,
    quaternion_from_rotation,
    rigid_transform,
    rotation_from_quaternion,
    rotation_z,
)

Array = np.ndarray
Record = dict[str, Any]
Rng = np.random.Generator
Change = Callable[[Array], Array]
Injection = Callable[[Record, Rng], list[str]]  # changes a scene, and returns the names of the wrong cameras

OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])
INCH_M, FOOT_M = 0.0254, 0.3048


@dataclass(frozen=True)
class Mistake:
    """inject: makes the mistake. cause: words of the right cause, alternatives separated by `|`.

    part: of the report that must name the cause: "cameras", "drive" or "ground_truth".
    compares_images: whether only the images show the mistake.
    """

    inject: Injection
    cause: str
    part: str = "cameras"
    compares_images: bool = False


def _calibrations(record: Record) -> dict[str, list[Record]]:
    """All records with a calibration, by camera: that of the scene, or those of the frames."""
    found: dict[str, list[Record]] = {}
    for cameras in (record.get("cameras", {}), *(frame["cameras"] for frame in record["frames"])):
        for name, camera in cameras.items():
            if "camera_T_ego" in camera:
                found.setdefault(name, []).append(camera)
    return found


def _change(field: str, change: Change, one: bool = False) -> Injection:
    def inject(record: Record, rng: Rng) -> list[str]:
        calibrations = _calibrations(record)
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


def _misread_angles(convert: Callable[[Array], Array]) -> Change:
    def change(m: Array) -> Array:
        ego_T_camera = inverse(m)
        angles = convert(_euler(ego_T_camera[:3, :3]))
        return inverse(rigid_transform(_from_euler(angles), ego_T_camera[:3, 3]))

    return change


def _origin_above_cameras(low_m: float, high_m: float) -> Injection:
    def inject(record: Record, rng: Rng) -> list[str]:
        heights = [inverse(np.array(each[0]["camera_T_ego"]))[2, 3] for each in _calibrations(record).values()]
        height = float(np.median(heights)) + rng.uniform(low_m, high_m)
        return _all(lambda m: m @ rigid_transform(np.eye(3), [0, 0, height]))(record, rng)

    return inject


def _exchange_centre(k: Array) -> Array:
    k[0, 2], k[1, 2] = k[1, 2], k[0, 2]
    return k


def _normalise(record: Record, rng: Rng) -> list[str]:
    for cameras in _calibrations(record).values():
        for camera in cameras:
            scale = np.diag([1 / camera["width_px"], 1 / camera["height_px"], 1])
            camera["intrinsics_px"] = (scale @ np.array(camera["intrinsics_px"])).tolist()
    return list(_calibrations(record))


def _yaw_one(record: Record, rng: Rng) -> list[str]:
    yaw = np.radians(rng.uniform(17, 28) * rng.choice([-1, 1]))
    calibrations = _calibrations(record)
    level = [name for name in sorted(calibrations) if "tele" not in name]
    name = str(rng.choice(level))
    for camera in calibrations[name]:
        ego_T_camera = inverse(np.array(camera["camera_T_ego"]))
        rotation = rotation_z(yaw) @ ego_T_camera[:3, :3]
        camera["camera_T_ego"] = inverse(rigid_transform(rotation, ego_T_camera[:3, 3])).tolist()
    return [name]


def _exchange_calibrations(record: Record, rng: Rng) -> list[str]:
    calibrations = _calibrations(record)
    one, other = _pair(record, rng)
    for mine, theirs in zip(calibrations[one], calibrations[other], strict=True):
        for field in ("camera_T_ego", "intrinsics_px"):
            mine[field], theirs[field] = theirs[field], mine[field]
    return [one, other]


def _copy_calibration(record: Record, rng: Rng) -> list[str]:
    one, other = _pair(record, rng)
    calibrations = _calibrations(record)
    for mine, theirs in zip(calibrations[one], calibrations[other], strict=True):
        mine.update({key: theirs[key] for key in ("camera_T_ego", "intrinsics_px")})
    return [one, other]


def _pair(record: Record, rng: Rng) -> tuple[str, str]:
    """Two cameras that look in different directions."""
    names = sorted(name for name in record["frames"][0]["cameras"] if "tele" not in name)
    one, other = rng.choice(names, 2, replace=False)
    return str(one), str(other)


def _mirrored_pair(record: Record, rng: Rng) -> tuple[str, str]:
    """A camera with its counterpart on the other side."""
    azimuths = {}
    for name, cameras in _calibrations(record).items():
        axis = np.array(cameras[0]["camera_T_ego"])[2]
        azimuths[name] = np.degrees(np.arctan2(axis[1], axis[0]))
    side = [name for name in sorted(azimuths) if 30 < azimuths[name] < 150]
    one = str(rng.choice(side))
    return one, min(azimuths, key=lambda name: abs(azimuths[name] + azimuths[one]))


def _exchange_images(pair: Callable[[Record, Rng], tuple[str, str]]) -> Injection:
    def inject(record: Record, rng: Rng) -> list[str]:
        one, other = pair(record, rng)
        for frame in record["frames"]:
            cameras = frame["cameras"]
            cameras[one]["image"], cameras[other]["image"] = cameras[other]["image"], cameras[one]["image"]
        return [one, other]

    return inject


def _freeze(one: bool) -> Injection:
    def inject(record: Record, rng: Rng) -> list[str]:
        frames = record["frames"]
        names = [str(rng.choice(sorted(frames[0]["cameras"])))] if one else list(frames[0]["cameras"])
        for frame in frames:
            for name in names:
                frame["cameras"][name]["image"] = frames[0]["cameras"][name]["image"]
        return names

    return inject


def _twin(record: Record, rng: Rng) -> list[str]:
    one, other = _pair(record, rng)
    for frame in record["frames"]:
        frame["cameras"][one]["image"] = frame["cameras"][other]["image"]
    return [one, other]


def _lose(record: Record, rng: Rng) -> list[str]:
    name = str(rng.choice(sorted(record["frames"][0]["cameras"])))
    for frame in record["frames"]:
        frame["cameras"][name]["image"] = None
    return [name]


def _half_size(record: Record, rng: Rng) -> list[str]:
    for cameras in _calibrations(record).values():
        for camera in cameras:
            camera["width_px"], camera["height_px"] = camera["width_px"] // 2, camera["height_px"] // 2
            camera["intrinsics_px"] = (np.diag([0.5, 0.5, 1]) @ np.array(camera["intrinsics_px"])).tolist()
    return list(_calibrations(record))


def _times(change: Callable[[int, float], float]) -> Injection:
    def inject(record: Record, rng: Rng) -> list[str]:
        for index, frame in enumerate(record["frames"]):
            frame["timestamp_s"] = change(index, frame["timestamp_s"])
        return []

    return inject


def _poses(change: Callable[[int, Array, Array], Array]) -> Injection:
    """change: from the index, the pose and the first pose to the wrong pose."""

    def inject(record: Record, rng: Rng) -> list[str]:
        first = np.array(record["frames"][0]["global_T_ego"], float)
        for index, frame in enumerate(record["frames"]):
            frame["global_T_ego"] = change(index, np.array(frame["global_T_ego"], float), first).tolist()
        return []

    return inject


def _position(factor: float) -> Injection:
    return _poses(lambda index, pose, first: rigid_transform(pose[:3, :3], pose[:3, 3] * factor))


def _latitude(index: int, pose: Array, first: Array) -> Array:
    east, north, up = pose[:3, 3] - first[:3, 3]
    return rigid_transform(pose[:3, :3], [8.4 + east / 73_000, 49.01 + north / 111_320, up])


def _heading(change: Callable[[float], float]) -> Injection:
    return _poses(
        lambda index, pose, first: rigid_transform(
            rotation_z(change(float(np.arctan2(pose[1, 0], pose[0, 0])))), pose[:3, 3]
        )
    )


def _pose_quaternion(order: tuple[int, ...]) -> Injection:
    return _poses(
        lambda index, pose, first: rigid_transform(
            rotation_from_quaternion(quaternion_from_rotation(pose[:3, :3])[list(order)]), pose[:3, 3]
        )
    )


def _turn_north(record: Record) -> None:
    """Turn the global frame so that the drive leads about to the north-east: headings of about 0 hide mistakes."""
    first = np.array(record["frames"][0]["global_T_ego"], float)
    turn = rotation_z(0.9 - np.arctan2(first[1, 0], first[0, 0]))
    for frame in record["frames"]:
        pose = np.array(frame["global_T_ego"], float)
        position = first[:3, 3] + turn @ (pose[:3, 3] - first[:3, 3])
        frame["global_T_ego"] = rigid_transform(turn @ pose[:3, :3], position).tolist()


def _north(inject: Injection) -> Injection:
    def turned(record: Record, rng: Rng) -> list[str]:
        _turn_north(record)
        return inject(record, rng)

    return turned


def _boxes(change: Callable[[Record, Record], None]) -> Injection:
    """change: of one box, with its frame."""

    def inject(record: Record, rng: Rng) -> list[str]:
        for frame in record["frames"]:
            for box in frame["boxes"]:
                change(box, frame)
        return []

    return inject


def _centre(change: Callable[[Array, Record], Array]) -> Injection:
    return _boxes(lambda box, frame: box.update(center_m=change(np.array(box["center_m"]), frame).tolist()))


def _size(change: Callable[[list[float]], list[float]]) -> Injection:
    return _boxes(lambda box, frame: box.update(size_wlh_m=change(box["size_wlh_m"])))


def _yaw(change: Callable[[float], float]) -> Injection:
    return _boxes(lambda box, frame: box.update(yaw_rad=change(box["yaw_rad"])))


def _to_front_camera(centre: Array, frame: Record) -> Array:
    camera = max(frame["_cameras"].values(), key=lambda each: each["camera_T_ego"][2][0])
    return (np.array(camera["camera_T_ego"]) @ [*centre, 1])[:3]


def _camera_axes(record: Record, rng: Rng) -> list[str]:
    for frame in record["frames"]:
        frame["_cameras"] = {
            name: {**record.get("cameras", {}).get(name, {}), **camera} for name, camera in frame["cameras"].items()
        }
    _centre(_to_front_camera)(record, rng)
    for frame in record["frames"]:
        del frame["_cameras"]
    return []


def _rename(record: Record, rng: Rng) -> list[str]:
    names = {"car": "Car", "pedestrian": "Pedestrian", "truck": "LargeVehicle", "bicycle": "Cyclist"}
    _boxes(lambda box, frame: box.update({"class": names.get(box["class"], f"{box['class']} x")}))(record, rng)
    return []


_INVERSE = "inverse of camera_T_ego"
_AZIMUTH = "azimuth in camera_T_ego is wrong"

MISTAKES: dict[str, Mistake] = {
    "extrinsics inverted, all": Mistake(_all(inverse), _INVERSE),
    "extrinsics inverted, one": Mistake(_one(inverse), _INVERSE),
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
    "one camera yawed": Mistake(_yaw_one, _AZIMUTH, compares_images=True),
    "left and right images exchanged": Mistake(
        _exchange_images(_mirrored_pair), "images of this camera and of .* are exchanged", compares_images=True
    ),
    "two images exchanged": Mistake(
        _exchange_images(_pair), "images of this camera and of .* are exchanged", compares_images=True
    ),
    "one camera frozen": Mistake(_freeze(True), "camera is frozen", compares_images=True),
    "all cameras frozen": Mistake(_freeze(False), "same images were given again", "drive", compares_images=True),
    "one image twice": Mistake(_twin, "cannot take the same image|given under both names", compares_images=True),
    "one camera lost": Mistake(_lose, "lost throughout"),
    "times in ms": Mistake(_times(lambda i, t: 500.0 * i), "in milliseconds", "drive"),
    "times in us": Mistake(_times(lambda i, t: 5e5 * i), "in microseconds", "drive"),
    "Unix times in ms": Mistake(_times(lambda i, t: 1000 * t), "in milliseconds", "drive"),
    "Unix times in us": Mistake(_times(lambda i, t: 1e6 * t), "in microseconds", "drive"),
    "times in float32": Mistake(_times(lambda i, t: float(np.float32(t))), "float32", "drive"),
    "slow rig": Mistake(_times(lambda i, t: 1.53e9 + 3 * i), "takes few frames", "drive"),
    "frames in reverse order": Mistake(_times(lambda i, t: 1.53e9 - i / 2), "out of order", "drive"),
    "constant pose": Mistake(_poses(lambda i, pose, first: first), "one pose was given", "drive", True),
    "latitude and longitude": Mistake(_poses(_latitude), "latitude and longitude", "drive", True),
    "positions in km": Mistake(_position(0.001), "in kilometres", "drive", True),
    "positions in mm": Mistake(_position(1000), "in millimetres", "drive"),
    "positions in cm": Mistake(_position(100), "in centimetres", "drive"),
    "positions in inches": Mistake(_position(1 / INCH_M), "in inches", "drive"),
    "poses inverted": Mistake(_north(_poses(lambda i, pose, first: inverse(pose))), "is inverted", "drive"),
    "heading from the y axis": Mistake(_heading(lambda yaw: yaw - np.pi / 2), "y forward instead of x", "drive"),
    "headings in degrees": Mistake(_north(_heading(np.degrees)), "degrees were read as radians", "drive", True),
    "headings read as degrees": Mistake(_north(_heading(np.radians)), "radians were read as degrees", "drive"),
    "headings to the right": Mistake(_north(_heading(lambda yaw: -yaw)), "increase to the right", "drive"),
    "pose quaternion x y z w": Mistake(_north(_pose_quaternion((1, 2, 3, 0))), "wrong order", "drive"),
    "headings reversed": Mistake(_heading(lambda yaw: yaw + np.pi), "headings are reversed", "drive", True),
    "yaw in degrees": Mistake(_yaw(lambda yaw: float(np.degrees(yaw))), "yaws are in degrees", "ground_truth"),
    "yaw converted twice": Mistake(
        _yaw(lambda yaw: float(np.radians(yaw))), "degrees to radians, but were", "ground_truth"
    ),
    "yaw along y": Mistake(_yaw(lambda yaw: yaw - np.pi / 2), "yaw 0 points along y", "ground_truth"),
    "yaw to the right": Mistake(_yaw(lambda yaw: -yaw), "yaw increases to the right|camera axes", "ground_truth"),
    "width and length exchanged": Mistake(_size(lambda s: [s[1], s[0], s[2]]), "are exchanged", "ground_truth"),
    "sizes as l h w": Mistake(_size(lambda s: [s[1], s[2], s[0]]), "order length, height, width", "ground_truth"),
    "sizes in cm": Mistake(_size(lambda s: [100 * x for x in s]), "sizes are in centimetres", "ground_truth"),
    "half sizes": Mistake(_size(lambda s: [x / 2 for x in s]), "half lengths", "ground_truth"),
    "boxes in camera axes": Mistake(_camera_axes, "in camera axes", "ground_truth"),
    "boxes in lidar axes": Mistake(
        _centre(lambda c, f: np.array([-c[1], c[0], c[2]])), "x right, y forward", "ground_truth"
    ),
    "boxes in the global frame": Mistake(
        _centre(lambda c, f: (np.array(f["global_T_ego"]) @ [*c, 1])[:3]), "in the global frame", "ground_truth"
    ),
    "bottom centres": Mistake(
        _boxes(lambda box, f: box["center_m"].__setitem__(2, box["center_m"][2] - box["size_wlh_m"][2] / 2)),
        "bottoms of the boxes",
        "ground_truth",
    ),
    "boxes relative to the roof": Mistake(
        _centre(lambda c, f: c - [0, 0, 1.9]), "origin of the boxes is", "ground_truth"
    ),
    "unknown class names": Mistake(_rename, "another data set", "ground_truth"),
}
