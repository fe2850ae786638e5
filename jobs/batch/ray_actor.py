"""The actor of Ray that runs scenes. This module is imported on the machines of the cluster."""

import json
import os
import socket
from typing import Any

from ...runtime.errors import DuoSpaceNetError
from ..error_reply import error_reply
from .batch_records import BatchSettings
from .scene_job import SceneJob
from .scene_list import Scene


class SceneActor:
    """Runs the scene of each row that it is called with."""

    def __init__(self, settings: dict[str, Any], home: str) -> None:
        """settings: the fields of a `BatchSettings`. home: the home folder of the user, "" for that of this process."""
        if home:
            os.environ["HOME"] = home
        self._settings = BatchSettings(**settings)
        self._job: SceneJob | None = None

    def __call__(self, row: dict[str, Any]) -> dict[str, Any]:
        """Run a scene, given as JSON, and return the reply as JSON: an outcome, or an error of the bundle."""
        try:
            # Loaded here, because an exception of the constructor would make Ray start the actor again and again.
            self._job = self._job or SceneJob(self._settings, f"{socket.gethostname()}, process {os.getpid()}")
        except DuoSpaceNetError as error:
            return {"reply": json.dumps(error_reply(error))}
        outcome = self._job.run(Scene.from_dict(json.loads(row["scene"])))
        return {"reply": json.dumps({"outcome": outcome.model_dump(mode="json")})}
