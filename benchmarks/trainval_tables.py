"""Tables of the size of nuScenes' v1.0-trainval, with generated rows and without files of sensors.

Sizes: 850 scenes, 34,149 key frames, 2,631,083 rows of sample_data and ego_pose, 1,166,187 annotations of 64,386
objects. Rows have the fields, the layout and about the length of the published ones. Source: nuscenes.org.
"""

import json
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from duospacenet.data.class_names import NUSCENES_CATEGORIES
from duospacenet.data.nuscenes.splits import published_split

NUM_SAMPLES = 34_149
NUM_SAMPLE_DATA = 2_631_083
NUM_ANNOTATIONS = 1_166_187
TRACK_LENGTH = 18
CAMERAS = ("CAM_FRONT", "CAM_FRONT_RIGHT", "CAM_BACK_RIGHT", "CAM_BACK", "CAM_BACK_LEFT", "CAM_FRONT_LEFT")
RADARS = ("RADAR_FRONT", "RADAR_FRONT_LEFT", "RADAR_FRONT_RIGHT", "RADAR_BACK_LEFT", "RADAR_BACK_RIGHT")
SENSORS = (*CAMERAS, "LIDAR_TOP", *RADARS)
START_US = 1_532_402_927_647_951

Row = dict[str, Any]


def write_trainval_tables(folder: Path, scale: float = 1.0) -> None:
    """Write the tables to a new folder. scale: share of the scenes; 1 gives all 850."""
    folder.mkdir(parents=True)
    names = sorted((*published_split("train"), *published_split("val")))
    names = names[: max(1, round(scale * len(names)))]
    num_samples, num_data, num_annotations = (
        round(total * len(names) / 850) for total in (NUM_SAMPLES, NUM_SAMPLE_DATA, NUM_ANNOTATIONS)
    )
    scenes = [number * len(names) // num_samples for number in range(num_samples)]  # of each sample
    for name, rows in _small_tables(names).items():
        _write(folder, name, rows)
    _write(folder, "sample", (_sample(number, scene) for number, scene in enumerate(scenes)))
    _write(folder, "sample_data", _sample_data(scenes, num_data))
    _write(folder, "ego_pose", (_ego_pose(number) for number in range(num_data)))
    tracks = list(_tracks(scenes, num_annotations))
    _write(folder, "instance", (_instance(number, *track) for number, track in enumerate(tracks)))
    _write(folder, "sample_annotation", _annotations(tracks))


def _write(folder: Path, name: str, rows: Iterable[Row]) -> None:
    """Write a table as the published ones are: one line per value."""
    encode = json.JSONEncoder(indent=0).encode
    with (folder / f"{name}.json").open("w", encoding="ascii") as file:
        for number, row in enumerate(rows):
            file.write(f"{',' if number else '['}\n{encode(row)}")
        file.write("\n]\n")


def _small_tables(names: list[str]) -> dict[str, list[Row]]:
    numbers = range(len(names))
    return {
        "log": [{"token": _token("log", 0), "logfile": "n015", "vehicle": "n015", "location": "singapore-onenorth"}],
        "scene": [
            {"token": _token("scene", number), "log_token": _token("log", 0), "name": names[number]}
            for number in numbers
        ],
        "sensor": [
            {"token": _token("sensor", number), "channel": name, "modality": name.partition("_")[0].lower()}
            | ({"modality": "camera"} if name in CAMERAS else {})
            for number, name in enumerate(SENSORS)
        ],
        "calibrated_sensor": [
            {
                "token": _token("calibrated", scene * len(SENSORS) + number),
                "sensor_token": _token("sensor", number),
                "translation": [1.72200568478, 0.00475453292289, 1.49491291905],
                "rotation": [0.5077241387638071, -0.4973392230703816, 0.49837167536166627, -0.4964832014373754],
                "camera_intrinsic": [[1252.81, 0.0, 826.59], [0.0, 1252.81, 469.98], [0.0, 0.0, 1.0]]
                if number < len(CAMERAS)
                else [],
            }
            for scene in numbers
            for number in range(len(SENSORS))
        ],
        "category": [{"token": _token("category", i), "name": n} for i, n in enumerate(NUSCENES_CATEGORIES)],
        "attribute": [{"token": _token("attribute", i), "name": f"vehicle.{i}"} for i in range(8)],
        "visibility": [{"token": str(i), "level": f"v{i}"} for i in range(1, 5)],
    }


def _sample(number: int, scene: int) -> Row:
    return {
        "token": _token("sample", number),
        "timestamp": START_US + 500_000 * number,
        "prev": "",
        "next": "",
        "scene_token": _token("scene", scene),
    }


def _sample_data(scenes: list[int], num_data: int) -> Iterator[Row]:
    """Yield the key frames of all sensors, and between them as many sweeps as there are in v1.0-trainval."""
    for number in range(num_data):
        sample = number * len(scenes) // num_data
        place = number - -(-sample * num_data // len(scenes))
        sensor = SENSORS[place % len(SENSORS)]
        timestamp = START_US + 500_000 * sample + 1_000 * place
        folder = "samples" if place < len(SENSORS) else "sweeps"
        is_camera = sensor in CAMERAS
        yield {
            "token": _token("data", number),
            "sample_token": _token("sample", sample),
            "ego_pose_token": _token("data", number),
            "calibrated_sensor_token": _token("calibrated", scenes[sample] * len(SENSORS) + place % len(SENSORS)),
            "timestamp": timestamp,
            "fileformat": "jpg" if is_camera else "pcd",
            "is_key_frame": place < len(SENSORS),
            "height": 900 if is_camera else 0,
            "width": 1600 if is_camera else 0,
            "filename": f"{folder}/{sensor}/n015-2018-07-24-11-22-45+0800__{sensor}__{timestamp}.jpg",
            "prev": _token("data", number - 1),
            "next": _token("data", number + 1),
        }


def _ego_pose(number: int) -> Row:
    return {
        "token": _token("data", number),
        "timestamp": START_US + 6_500 * number,
        "rotation": [0.5720320396729045, -0.0016977771610471074, 0.011798001930183783, -0.8201446642457809],
        "translation": [411.3039349319818 + 1e-4 * number, 1180.8903791765097, 0.0],
    }


def _tracks(scenes: list[int], num_annotations: int) -> Iterator[tuple[int, int]]:
    """Yield the first sample and the length of each track. No track leaves its scene."""
    left = num_annotations
    starts = [number for number in range(len(scenes)) if number == 0 or scenes[number] != scenes[number - 1]]
    ends = [*starts[1:], len(scenes)]
    turn = 0
    while left:
        for start, end in zip(starts, ends, strict=True):
            first = start + (turn * 7) % (end - start)
            length = min(TRACK_LENGTH, end - first, left)
            if length:
                yield first, length
            left -= length
        turn += 1


def _instance(number: int, first: int, length: int) -> Row:
    return {
        "token": _token("instance", number),
        "category_token": _token("category", number % len(NUSCENES_CATEGORIES)),
        "nbr_annotations": length,
        "first_annotation_token": "",
        "last_annotation_token": "",
    }


def _annotations(tracks: list[tuple[int, int]]) -> Iterator[Row]:
    number = 0
    for instance, (first, length) in enumerate(tracks):
        for step in range(length):
            yield {
                "token": _token("annotation", number),
                "sample_token": _token("sample", first + step),
                "instance_token": _token("instance", instance),
                "visibility_token": str(1 + number % 4),
                "attribute_tokens": [_token("attribute", number % 8)],
                "translation": [373.256 + 0.5 * step, 1130.419, 0.8 + 1e-6 * number],
                "size": [0.621, 0.669, 1.642],
                "rotation": [0.9831098797903927, 0.0, 0.0, -0.18301629506281616],
                "prev": _token("annotation", number - 1) if step else "",
                "next": _token("annotation", number + 1) if step + 1 < length else "",
                "num_lidar_pts": number % 50,
                "num_radar_pts": 0,
            }
            number += 1


def _token(table: str, number: int) -> str:
    """Return a token of 32 hexadecimal digits."""
    return f"{sum(table.encode()):04x}{number:028x}"
