"""Prints, for each sample of a root, what nuscenes-devkit reads: poses, camera calibrations, boxes and velocities.

Arguments: the root and the version. Boxes and their points are in the ego frame of LIDAR_TOP.
"""

import json
import sys

import numpy as np
from nuscenes.nuscenes import NuScenes
from nuscenes.utils.data_classes import Box
from nuscenes.utils.geometry_utils import transform_matrix
from pyquaternion import Quaternion


def pose(record: dict, inverse: bool = False) -> np.ndarray:
    return transform_matrix(record["translation"], Quaternion(record["rotation"]), inverse=inverse)


def read_sample(nusc: NuScenes, sample: dict) -> dict:
    lidar = nusc.get("sample_data", sample["data"]["LIDAR_TOP"])
    ego = nusc.get("ego_pose", lidar["ego_pose_token"])
    return {
        "scene": nusc.get("scene", sample["scene_token"])["name"],
        "timestamp_us": lidar["timestamp"],
        "global_T_ego": pose(ego).tolist(),
        "cameras": {
            name: read_camera(nusc, token, pose(ego)) for name, token in sample["data"].items() if "CAM" in name
        },
        "boxes": [read_box(nusc, token, ego) for token in sample["anns"]],
    }


def read_camera(nusc: NuScenes, token: str, global_T_ego: np.ndarray) -> dict:
    data = nusc.get("sample_data", token)
    sensor = nusc.get("calibrated_sensor", data["calibrated_sensor_token"])
    at_camera = nusc.get("ego_pose", data["ego_pose_token"])
    _, boxes, intrinsics = nusc.get_sample_data(token)
    return {
        "intrinsics": intrinsics.tolist(),
        "camera_T_ego": (pose(sensor, True) @ pose(at_camera, True) @ global_T_ego).tolist(),
        "visible_centres": {box.token: box.center.tolist() for box in boxes},
    }


def read_box(nusc: NuScenes, token: str, ego: dict) -> dict:
    row = nusc.get("sample_annotation", token)
    box = Box(row["translation"], row["size"], Quaternion(row["rotation"]))
    box.translate(-np.array(ego["translation"]))
    box.rotate(Quaternion(ego["rotation"]).inverse)
    attributes = [nusc.get("attribute", attribute)["name"] for attribute in row["attribute_tokens"]]
    return {
        "token": token,
        "category": row["category_name"],
        "centre": box.center.tolist(),
        "size": row["size"],
        "yaw_global": Quaternion(row["rotation"]).yaw_pitch_roll[0],
        "velocity_global": nusc.box_velocity(token)[:2].tolist(),
        "attributes": attributes,
        "num_points": row["num_lidar_pts"] + row["num_radar_pts"],
    }


if __name__ == "__main__":
    nuscenes = NuScenes(version=sys.argv[2], dataroot=sys.argv[1], verbose=False)
    print(json.dumps({sample["token"]: read_sample(nuscenes, sample) for sample in nuscenes.sample}))  # noqa: T201
