"""What happens in a batch, as the workers report it."""

from typing import NamedTuple

from .batch_records import SceneOutcome


class SceneFrames(NamedTuple):
    """frames: number of frames in the results of an unfinished scene."""

    scene_id: str
    frames: int


class SceneEnded(NamedTuple):
    """A scene is done or has failed."""

    scene_id: str
    outcome: SceneOutcome


class WorkerLost(NamedTuple):
    """The process of a worker has ended while it processed a scene, which is done again. cause: how it ended."""

    worker: str
    scene_id: str
    cause: str


BatchEvent = SceneFrames | SceneEnded | WorkerLost
