"""A scripted drive for programs that run bundles without this toolkit, and Python's results for it.

The drive has every event that the bundle format has a rule for. Each image size takes another branch of the resize
rules, for any size of the network's input.

    python -m tests.helpers.consumer_drive BUNDLE FOLDER [--engine openvino]

writes the scene folder `FOLDER/scene` and Python's results `FOLDER/results.jsonl`.
"""

import argparse
import json
import math
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from duospacenet.data.results import ResultsFile, frame_result
from duospacenet.data.scene_folder import SceneFolder
from duospacenet.data.scene_writer import write_scene
from duospacenet.runtime import Frame, Pipeline
from duospacenet.runtime.bundle.manifest import read_manifest
from duospacenet.runtime.geometry import rigid_transform, rotation_z
from duospacenet.synthetic.drive import SyntheticDrive
from tests.helpers.streams import lose_cameras, turn_cameras

START_S = 1_533_151_600.0
FAR_M = np.array([4_500_000.25, 5_400_000.5, 310.0])  # UTM coordinates: float32 numbers are 0.5 m apart there
WRITTEN_WITH_3_DECIMALS = rotation_z(0.6).round(3)  # rigid to 0.001, so it is accepted and made rigid

Result = dict[str, Any]


def write_consumer_drive(bundle: Path, folder: Path) -> Path:
    """Write the drive as a scene folder with PNG images, in sizes that fit the bundle's input. Returns `folder`."""
    preprocessing = read_manifest(bundle).preprocessing
    write_scene(folder, consumer_drive((preprocessing.width_px, preprocessing.height_px)))
    return folder


def write_python_results(bundle: Path, scene_folder: Path, out: Path, **options: Any) -> Path:
    """Run Python's pipeline over a scene folder, and write its results to the file `out`. Returns `out`.

    options: of `Pipeline.load`, for example engine="openvino".
    """
    stream = Pipeline.load(bundle, **options).stream()
    with ResultsFile(out) as file:
        for frame in SceneFolder(scene_folder):
            file.write(frame_result(frame, stream.step(frame), {}))
    return out


def consumer_drive(input_size_px: tuple[int, int]) -> list[Frame]:
    """Return the frames of the drive. input_size_px: width and height of the network's images."""
    rendered = list(SyntheticDrive(1, frames=12, image_size=tuple(2 * size for size in input_size_px)))
    sizes = native_sizes(input_size_px)
    frames = [_with_sizes(frame, sizes) for frame in rendered]
    cameras = list(frames[0].cameras)
    rounded_to_even = [(2 * input_size_px[0] + 1, 2 * input_size_px[1])] * len(cameras)
    return _timed(
        ("drive A", 0.5, frames[0]),
        ("drive A", 0.5, frames[1]),
        ("drive A", 0.5, lose_cameras(frames[2], cameras[1])),
        ("drive A", 0.5, turn_cameras(frames[3])),
        ("drive A", 0.5, lose_cameras(frames[4], *cameras)),  # skipped: the next frame is compared with frame 3
        ("drive A", 0.5, _with_cameras(frames[5], cameras[3], cameras[0], cameras[2])),  # absent cameras, another order
        ("drive A", 0.5, frames[6]),
        ("drive A", 2.5, frames[7]),  # reset: a gap of more than 2 s
        ("drive A", 0.5, frames[8]),
        ("drive A", 0.5, _moved(frames[9], 60.0)),  # reset: 60 m in 0.5 s
        ("drive A", 0.5, _moved(frames[10], 60.0)),
        ("drive A", 0.5, _turned(_moved(frames[11], 60.0), 2.0)),  # reset: 2 rad in 0.5 s
        ("drive B", -5.0, lose_cameras(frames[0], *cameras[1:])),  # reset: another scene, with an older time stamp
        ("drive C", 0.5, lose_cameras(frames[1], *cameras)),  # skipped: the history of drive B goes on
        ("drive B", 0.5, frames[2]),
        ("drive B", 0.5, _with_cameras(frames[3], cameras[4])),
        ("drive B", 0.5, _with_sizes(frames[4], rounded_to_even)),
        ("drive D", 0.5, _with_pose(frames[5], rotation_z(0.6), FAR_M)),  # reset
        ("drive D", 0.5, _with_pose(frames[6], WRITTEN_WITH_3_DECIMALS, np.add(FAR_M, (4.0, 3.0, 0.1)))),
        ("drive D", 0.5, _with_pose(frames[7], rotation_z(0.65), np.add(FAR_M, (8.0, 6.0, 0.2)))),
    )


def native_sizes(input_size_px: tuple[int, int]) -> list[tuple[int, int]]:
    """Return six image sizes (width, height): one for each branch of the resize rules."""
    width, height = input_size_px
    return [
        (2 * width, 2 * height),  # halved once
        (4 * width, 4 * height),  # halved twice
        (width, height),  # copied
        (round(1.7 * width), round(2.1 * height)),  # shrunk, and cropped at the top
        (round(0.6 * width), round(0.7 * height)),  # enlarged, and cropped at the top
        (round(2.3 * width) + 1, round(1.6 * height)),  # shrunk, and cropped on both sides
    ]


def read_lines(path: Path) -> list[Result]:
    """Read the lines of a results file."""
    return [json.loads(line) for line in path.read_text().splitlines()]


def differences(found: Sequence[Result], expected: Sequence[Result], tolerance: float = 1e-4) -> list[str]:
    """Compare two results files, and describe every difference.

    tolerance: of the scores and of the numbers of a box [m, rad, m/s]. Two boxes whose scores differ by less may be
        in another order, and may be the last ones or missing at the end of a full list.
    """
    if len(found) != len(expected):
        return [f"expected {len(expected)} frames; found {len(found)}"]
    return [
        f"frame {index}: {difference}"
        for index, (one, other) in enumerate(zip(found, expected, strict=True))
        for difference in _frame_differences(one, other, tolerance)
    ]


def _frame_differences(found: Result, expected: Result, tolerance: float) -> Iterable[str]:
    for field in ("scene", "token", "timestamp_s", "global_T_ego", "degraded", "dropped"):
        if found[field] != expected[field]:
            yield f"{field}: expected {expected[field]!r}; found {found[field]!r}"
    states = [_state(result) for result in (found, expected)]
    if states[0] != states[1]:
        yield f"history: expected {states[1]}; found {states[0]}"
    if len(found["boxes"]) != len(expected["boxes"]):
        yield f"expected {len(expected['boxes'])} boxes; found {len(found['boxes'])}"
    lowest = min((box["score"] for box in expected["boxes"]), default=0.0)
    left = list(found["boxes"])
    for index, box in enumerate(expected["boxes"]):
        match = next((other for other in left if _box_difference(other, box) <= tolerance), None)
        if match is not None:
            left.remove(match)
        elif box["score"] > lowest + tolerance:
            nearest = min((_box_difference(other, box) for other in found["boxes"]), default=math.inf)
            yield f"box {index}: found none within {tolerance:g}; the nearest differs by {nearest:.2g}"
    if any(box["score"] > lowest + tolerance for box in left):
        yield "found boxes that are not expected"
    scores = [box["score"] for box in found["boxes"]]
    if scores != sorted(scores, reverse=True):
        yield "found boxes that are not in the order of their scores"


def _state(result: Result) -> tuple[bool, int, bool, list[float]]:
    """Return whether a frame was skipped, the frames in its window, whether there was a reset, and the ages."""
    history = result["history"]
    ages_s = [round(age_s, 4) for age_s in history["ages_s"]]
    return result["skipped"] is not None, history["frames"], history["reset_reason"] is not None, ages_s


def _box_difference(one: Result, other: Result) -> float:
    """Return the largest difference of two boxes of a class, infinity for two classes. Yaws differ modulo 2 pi."""
    if one["class"] != other["class"]:
        return math.inf
    turn_rad = one["yaw_rad"] - other["yaw_rad"]
    numbers = [_numbers(box) for box in (one, other)]
    return max(abs(math.remainder(turn_rad, 2 * math.pi)), *(abs(a - b) for a, b in zip(*numbers, strict=True)))


def _numbers(box: Result) -> list[float]:
    return [box["score"], *box["center_m"], *box["size_wlh_m"], *box["velocity_m_s"]]


def _timed(*events: tuple[str, float, Frame]) -> list[Frame]:
    """Return frames with their scene, time stamp and token. events: scene, seconds since the frame before, frame."""
    timestamp_s, timed = START_S, []
    for index, (scene, elapsed_s, frame) in enumerate(events):
        timestamp_s += elapsed_s
        timed.append(replace(frame, scene=scene, timestamp_s=timestamp_s, token=f"{index:02}"))
    return timed


def _moved(frame: Frame, distance_m: float) -> Frame:
    return _with_pose(frame, frame.global_T_ego[:3, :3], frame.global_T_ego[:3, 3] + [distance_m, 0.0, 0.0])


def _turned(frame: Frame, angle_rad: float) -> Frame:
    return _with_pose(frame, frame.global_T_ego[:3, :3] @ rotation_z(angle_rad), frame.global_T_ego[:3, 3])


def _with_pose(frame: Frame, rotation: np.ndarray, position_m: np.ndarray) -> Frame:
    return replace(frame, global_T_ego=rigid_transform(rotation, position_m))


def _with_cameras(frame: Frame, *names: str) -> Frame:
    """Return the frame of a rig that has only these cameras, in this order."""
    return replace(
        frame,
        cameras={name: frame.cameras[name] for name in names},
        images={name: frame.images[name] for name in names},
    )


def _with_sizes(frame: Frame, sizes: Sequence[tuple[int, int]]) -> Frame:
    """Return the frame with stretched images of other sizes (width, height), and the calibrations for them."""
    cameras, images = {}, {}
    for (name, camera), (width, height) in zip(frame.cameras.items(), sizes, strict=True):
        image = frame.images[name]
        assert image is not None
        stretch = np.diag([width / camera.width_px, height / camera.height_px, 1.0])
        intrinsics_px = stretch @ camera.intrinsics_px
        cameras[name] = replace(camera, width_px=width, height_px=height, intrinsics_px=intrinsics_px)
        images[name] = np.asarray(cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA), np.uint8)
    return replace(frame, cameras=cameras, images=images)


def _main() -> None:
    parser = argparse.ArgumentParser(description="Write the scripted drive and Python's results for it.")
    parser.add_argument("bundle", type=Path)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--engine", default="onnxruntime")
    arguments = parser.parse_args()
    scene = write_consumer_drive(arguments.bundle, arguments.folder / "scene")
    write_python_results(arguments.bundle, scene, arguments.folder / "results.jsonl", engine=arguments.engine)


if __name__ == "__main__":
    _main()
