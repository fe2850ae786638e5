"""The process that runs scenes. The protocol of its lines is in `json_lines.py`.

The first request is the `BatchSettings`; the reply is `{"ready": true}`, or an error. Each further request is a scene;
the replies are `{"frames": N}` while it runs, and then `{"outcome": {...}}`.
"""

import sys

from ...runtime.errors import INTERRUPTED_EXIT_CODE, DuoSpaceNetError
from ..error_reply import error_reply
from .batch_records import BatchSettings
from .json_lines import Requester
from .scene_list import Scene


def main(name: str) -> None:
    """Run scenes until stdin is closed. name: of this worker, for the outcomes."""
    requester = Requester()
    try:
        settings = BatchSettings(**requester.receive())
        try:
            from .scene_job import SceneJob  # here: stdin is being watched while the libraries are imported

            job = SceneJob(settings, name)
        except DuoSpaceNetError as error:
            requester.send(error_reply(error))
            return
        requester.send({"ready": True})
        while True:
            scene = Scene.from_dict(requester.receive())
            outcome = job.run(scene, lambda frames: requester.send({"frames": frames}))
            requester.send({"outcome": outcome.model_dump(mode="json")})
    except (KeyboardInterrupt, BrokenPipeError):
        sys.exit(INTERRUPTED_EXIT_CODE)


if __name__ == "__main__":
    main(sys.argv[1])
