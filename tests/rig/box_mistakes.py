"""Mistakes in ground-truth boxes: headings, sizes, centres and class names."""

from collections.abc import Callable

import numpy as np

from tests.rig.scene_mistake import Array, Injection, Mistake, Record, Rng


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


def _camera_axes(record: Record, rng: Rng) -> list[str]:
    for frame in record["frames"]:
        frame["_cameras"] = {
            name: {**record.get("cameras", {}).get(name, {}), **camera} for name, camera in frame["cameras"].items()
        }
    _centre(_to_front_camera)(record, rng)
    for frame in record["frames"]:
        del frame["_cameras"]
    return []


def _to_front_camera(centre: Array, frame: Record) -> Array:
    camera = max(frame["_cameras"].values(), key=lambda each: each["camera_T_ego"][2][0])
    return (np.array(camera["camera_T_ego"]) @ [*centre, 1])[:3]


def _rename(record: Record, rng: Rng) -> list[str]:
    names = {"car": "Car", "pedestrian": "Pedestrian", "truck": "LargeVehicle", "bicycle": "Cyclist"}
    _boxes(lambda box, frame: box.update({"class": names.get(box["class"], f"{box['class']} x")}))(record, rng)
    return []


BOX_MISTAKES: dict[str, Mistake] = {
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
