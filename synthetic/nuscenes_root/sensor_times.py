"""The time stamps of the sensors: one sweep of the lidar per key frame, and each camera at its own time before it."""

import numpy as np

from ..nuscenes_rig import MOUNTS

LIDAR = "LIDAR_TOP"
KEY_FRAME_INTERVAL_US = 500_000
JITTER_US = 4_000
# The lidar turns clockwise and triggers a camera when it passes its field of view. These are typical times of nuScenes
# relative to the time stamp of the sweep, which is the time of the key frame.
CAMERA_DELAYS_US = {
    "CAM_FRONT": -35_200,
    "CAM_FRONT_RIGHT": -27_100,
    "CAM_FRONT_LEFT": -42_900,
    "CAM_BACK": -10_100,
    "CAM_BACK_LEFT": -300,
    "CAM_BACK_RIGHT": -19_600,
}
CAMERA_JITTER_US = 250
assert CAMERA_DELAYS_US.keys() == MOUNTS.keys()


class SensorTimes:
    """The time stamps [µs] of every sensor in every key frame of a scene."""

    def __init__(self, seed: int, num_frames: int) -> None:
        rng = np.random.default_rng([seed, 8])
        start = 1_530_000_000_000_000 + int(rng.integers(10**13))
        jitter = rng.integers(-JITTER_US, JITTER_US, num_frames)
        self.key_frames_us = [start + KEY_FRAME_INTERVAL_US * i + int(jitter[i]) for i in range(num_frames)]
        camera_jitter = rng.integers(-CAMERA_JITTER_US, CAMERA_JITTER_US, (num_frames, len(CAMERA_DELAYS_US)))
        self._cameras_us = [
            {
                name: time + delay + int(extra)
                for (name, delay), extra in zip(CAMERA_DELAYS_US.items(), row, strict=True)
            }
            for time, row in zip(self.key_frames_us, camera_jitter, strict=True)
        ]

    def of_cameras(self, index: int) -> dict[str, int]:
        """The time stamp of each camera in a key frame, counted from 0."""
        return self._cameras_us[index]

    def since_start_s(self, timestamp_us: int) -> float:
        """Seconds since the first key frame."""
        return (timestamp_us - self.key_frames_us[0]) * 1e-6
