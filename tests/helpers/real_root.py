"""The four real nuScenes frames beside this repository, written as a nuScenes root. Their images are only linked."""

import json
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from examples.nuscenes_scene import DATA, load_records

VERSION = "v1.0-mini"
CATEGORIES = {  # a category of each class
    "car": "vehicle.car",
    "truck": "vehicle.truck",
    "bus": "vehicle.bus.rigid",
    "trailer": "vehicle.trailer",
    "construction_vehicle": "vehicle.construction",
    "pedestrian": "human.pedestrian.adult",
    "motorcycle": "vehicle.motorcycle",
    "bicycle": "vehicle.bicycle",
    "traffic_cone": "movable_object.trafficcone",
    "barrier": "movable_object.barrier",
}


def write_real_root(folder: Path) -> Path:
    """Write the tables to a folder, with a link to the images. The folder is returned."""
    records = load_records()
    (folder / VERSION).mkdir(parents=True)
    (folder / "samples").symlink_to(DATA / "samples")
    for name, rows in _tables(records).items():
        (folder / VERSION / f"{name}.json").write_text(json.dumps(rows))
    return folder


def _tables(records: list[dict[str, Any]]) -> dict[str, list[dict]]:
    channels = ["LIDAR_TOP", *records[0]["cams"]]
    attributes = sorted({name for record in records for name in record["gt"]["attribute"] if name})
    log = {"logfile": "n008-2018-08-01-15-16-36-0400", "vehicle": "n008", "date_captured": "2018-08-01"}
    scene = records[0]["scene"]
    return {
        "category": [{"token": name, "name": name, "description": ""} for name in CATEGORIES.values()],
        "attribute": [{"token": name, "name": name, "description": ""} for name in attributes],
        "visibility": [{"token": "4", "level": "v80-100", "description": ""}],
        "log": [{"token": "log", **log, "location": records[0]["location"]}],
        "map": [],
        "scene": [
            {
                "token": scene,
                "log_token": "log",
                "nbr_samples": len(records),
                "first_sample_token": records[0]["token"],
                "last_sample_token": records[-1]["token"],
                "name": scene,
                "description": "",
            }
        ],
        "sensor": [
            {"token": name, "channel": name, "modality": "lidar" if "LIDAR" in name else "camera"} for name in channels
        ],
        "calibrated_sensor": [_calibrated(record, name) for record in records for name in channels],
        "sample": _chain(
            [
                {"token": record["token"], "timestamp": record["timestamp_us"], "scene_token": scene}
                for record in records
            ]
        ),
        "ego_pose": [_ego_pose(record, name) for record in records for name in channels],
        "sample_data": [row for name in channels for row in _chain([_data(record, name) for record in records])],
        **_annotations(records),
    }


def _calibrated(record: dict, channel: str) -> dict:
    camera = record["cams"].get(channel)
    return {
        "token": _token(record, channel),
        "sensor_token": channel,
        **_pose(camera["cam2ego"] if camera else record["lidar2ego"]),
        "camera_intrinsic": camera["K"] if camera else [],
    }


def _ego_pose(record: dict, channel: str) -> dict:
    """The ego pose at the sensor's own time stamp."""
    sensor = record["cams"].get(channel, record)
    return {"token": _token(record, channel), "timestamp": sensor["timestamp_us"], **_pose(sensor["ego2global"])}


def _data(record: dict, channel: str) -> dict:
    camera = record["cams"].get(channel, {})
    return {
        "token": _token(record, channel),
        "sample_token": record["token"],
        "ego_pose_token": _token(record, channel),
        "calibrated_sensor_token": _token(record, channel),
        "timestamp": camera.get("timestamp_us", record["timestamp_us"]),
        "fileformat": "jpg" if camera else "pcd",
        "is_key_frame": True,
        "height": camera.get("height", 0),
        "width": camera.get("width", 0),
        "filename": camera.get("file", f"samples/LIDAR_TOP/{record['token']}.pcd.bin"),
    }


def _annotations(records: list[dict]) -> dict[str, list[dict]]:
    """The tables instance and sample_annotation. Boxes go from the lidar frame to the global frame."""
    tracks: dict[int, list[dict]] = {}
    classes: dict[int, str] = {}
    for record in records:
        truth = record["gt"]
        global_T_lidar = np.array(record["lidar2global"])
        for row, track in enumerate(truth["track_id"]):
            lidar_R_box = Rotation.from_euler("z", truth["yaw"][row]).as_matrix()
            lidar_T_box = np.block([[lidar_R_box, np.array(truth["center"][row])[:, None]], [np.zeros(3), np.ones(1)]])
            attribute = truth["attribute"][row]
            annotation = {
                "token": f"{record['token']} {track}",
                "sample_token": record["token"],
                "instance_token": f"track {track}",
                "visibility_token": "4",
                "attribute_tokens": [attribute] if attribute else [],
                "size": truth["wlh"][row],
                **_pose(global_T_lidar @ lidar_T_box),
                "num_lidar_pts": truth["num_lidar_pts"][row],
                "num_radar_pts": truth["num_radar_pts"][row],
            }
            tracks.setdefault(track, []).append(annotation)
            classes[track] = truth["name"][row]
    instances = [
        {
            "token": f"track {track}",
            "category_token": CATEGORIES[classes[track]],
            "nbr_annotations": len(rows),
            "first_annotation_token": rows[0]["token"],
            "last_annotation_token": rows[-1]["token"],
        }
        for track, rows in tracks.items()
    ]
    return {"instance": instances, "sample_annotation": [row for rows in tracks.values() for row in _chain(rows)]}


def _chain(rows: list[dict]) -> list[dict]:
    """Rows with links to the one before and the one after."""
    tokens = [row["token"] for row in rows]
    links = zip(rows, ["", *tokens[:-1]], [*tokens[1:], ""], strict=True)
    return [{**row, "prev": previous, "next": following} for row, previous, following in links]


def _token(record: dict, channel: str) -> str:
    return f"{record['token']} {channel}"


def _pose(a_T_b: Any) -> dict[str, list[float]]:
    x, y, z, w = Rotation.from_matrix(np.array(a_T_b)[:3, :3]).as_quat()
    return {"translation": np.array(a_T_b)[:3, 3].tolist(), "rotation": [w, x, y, z]}
