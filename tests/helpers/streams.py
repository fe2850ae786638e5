"""Changed copies of frames, and streams over a list of frames, for tests of the pipeline."""

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from duospacenet.runtime import Detections, Frame, Pipeline
from duospacenet.runtime.geometry import rigid_transform, rotation_z

TINY_SIZE_PX = (160, 64)  # the image size of the tiny preset, so images of this size are not resized


def detect_all(pipeline: Pipeline, frames: Iterable[Frame], maps: bool = False) -> list[Detections]:
    """Return the results of a new stream over these frames."""
    stream = pipeline.stream(maps)
    return [stream.step(frame) for frame in frames]


def bitwise_equal(one: Detections, other: Detections) -> bool:
    """Return whether two results are equal bit for bit, apart from timings and reset reason."""
    arrays = [(d.boxes, d.scores, d.queries, *d.maps.values()) for d in (one, other)]
    values = [(d.classes, list(d.maps), d.dropped_queries, d.history.frames) for d in (one, other)]
    return values[0] == values[1] and all(
        a.dtype == b.dtype and a.shape == b.shape and a.tobytes() == b.tobytes() for a, b in zip(*arrays, strict=True)
    )


def lose_cameras(frame: Frame, *cameras: str) -> Frame:
    """Return the frame with these cameras lost."""
    return replace(frame, images={**frame.images, **dict.fromkeys(cameras)})


def with_camera(frame: Frame, name: str, **changes) -> Frame:
    """Return the frame with some fields of one camera's calibration replaced."""
    return replace(frame, cameras={**frame.cameras, name: replace(frame.cameras[name], **changes)})


def turn_cameras(frame: Frame) -> Frame:
    """Return the frame with every camera turned by 2 degrees and zoomed by 3 %."""
    turn, zoom = rigid_transform(rotation_z(np.radians(2.0)), [0.1, -0.05, 0.02]), np.diag([1.03, 1.03, 1.0])
    cameras = {
        name: replace(camera, camera_T_ego=camera.camera_T_ego @ turn, intrinsics_px=camera.intrinsics_px @ zoom)
        for name, camera in frame.cameras.items()
    }
    return replace(frame, cameras=cameras)


def move_ego(frame: Frame, distance_m: float, elapsed_s: float = 0.0) -> Frame:
    """Return the frame with the ego `distance_m` farther along global x, `elapsed_s` later."""
    pose = frame.global_T_ego.copy()
    pose[0, 3] += distance_m
    return replace(frame, global_T_ego=pose, timestamp_s=frame.timestamp_s + elapsed_s)


class SessionRecorder:
    """Wraps a session. Records the addresses of the tensors of its last run, and may change its outputs."""

    def __init__(self, session, change_outputs=dict):
        self._session, self.change_outputs = session, change_outputs
        self.inputs, self.outputs, self.num_runs = {}, {}, 0

    def run(self, inputs):
        outputs = self.change_outputs(self._session.run(inputs))
        self.num_runs += 1
        self.inputs, self.outputs = (
            {name: value.data_ptr() for name, value in tensors.items()} for tensors in (inputs, outputs)
        )
        return outputs


def record_sessions(pipeline, **change_outputs):
    """Return a copy of the pipeline with recorded sessions, and the recorders by graph name.

    change_outputs: a function of the outputs, by graph name.
    """
    recorders = {
        name: SessionRecorder(session, change_outputs.get(name, dict)) for name, session in pipeline.sessions.items()
    }
    return pipeline.with_sessions(recorders), recorders
