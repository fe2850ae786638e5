"""Small changes to frames, and drives through a pipeline, for tests of streams."""

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from duospacenet.runtime import Detections, Frame, Pipeline
from duospacenet.runtime.geometry import rigid, rotation_z

TINY_SIZE_PX = (160, 64)  # the network's input of the tiny preset: pictures of this size pass as they are


def detect_all(pipeline: Pipeline, frames: Iterable[Frame], maps: bool = False) -> list[Detections]:
    """The answers of a new stream."""
    stream = pipeline.stream(maps)
    return [stream.step(frame) for frame in frames]


def bitwise_equal(one: Detections, other: Detections) -> bool:
    """Whether two answers are equal bit for bit; how long it took and why a history ended aside."""
    arrays = [(d.boxes, d.scores, d.queries, *d.maps.values()) for d in (one, other)]
    words = [(d.classes, list(d.maps), d.dropped_queries, d.history.frames) for d in (one, other)]
    return words[0] == words[1] and all(
        a.dtype == b.dtype and a.shape == b.shape and a.tobytes() == b.tobytes() for a, b in zip(*arrays, strict=True)
    )


def lose_cameras(frame: Frame, *cameras: str) -> Frame:
    """The frame with these cameras lost."""
    return replace(frame, images={**frame.images, **dict.fromkeys(cameras)})


def with_camera(frame: Frame, name: str, **changes) -> Frame:
    """The frame with another calibration of one camera."""
    return replace(frame, cameras={**frame.cameras, name: replace(frame.cameras[name], **changes)})


def turn_cameras(frame: Frame) -> Frame:
    """The frame with every camera turned by 2 degrees and zoomed by 3 %."""
    turn, zoom = rigid(rotation_z(np.radians(2.0)), [0.1, -0.05, 0.02]), np.diag([1.03, 1.03, 1.0])
    cameras = {
        name: replace(camera, camera_T_ego=camera.camera_T_ego @ turn, intrinsics_px=camera.intrinsics_px @ zoom)
        for name, camera in frame.cameras.items()
    }
    return replace(frame, cameras=cameras)


def move_ego(frame: Frame, distance_m: float, elapsed_s: float = 0.0) -> Frame:
    """The frame at a place `distance_m` farther along global x, `elapsed_s` later."""
    pose = frame.global_T_ego.copy()
    pose[0, 3] += distance_m
    return replace(frame, global_T_ego=pose, timestamp_s=frame.timestamp_s + elapsed_s)


class SessionRecorder:
    """A session that notes where the tensors of its last run lie, and may spoil its outputs."""

    def __init__(self, session, spoil=dict):
        self._session, self.spoil = session, spoil
        self.inputs, self.outputs, self.num_runs = {}, {}, 0

    def run(self, inputs):
        outputs = self.spoil(self._session.run(inputs))
        self.num_runs += 1
        self.inputs, self.outputs = (
            {name: value.data_ptr() for name, value in tensors.items()} for tensors in (inputs, outputs)
        )
        return outputs


def record_sessions(pipeline, **spoil):
    spies = {name: SessionRecorder(session, spoil.get(name, dict)) for name, session in pipeline.sessions.items()}
    return Pipeline(pipeline.manifest, spies), spies
