"""The process that drives Ray. It keeps Ray's settings, threads, signal handlers and prints out of the command.

The request has the settings, the scenes, the address, and the number of workers. The replies are `{"outcome": {...}}`
for each scene, and then `{"end": true}`, or an error. See `json_lines.py`.
"""

import json
import shutil
import sys
from collections.abc import Iterator
from typing import Any

from ...runtime.errors import INTERRUPTED_EXIT_CODE, DuoSpaceNetError, UsageError
from ..error_reply import check_reply, error_reply
from .json_lines import Requester
from .ray_pool import LOCAL

OBJECT_STORE_BYTES = 100 * 2**20  # scenes and outcomes are small; the frames never pass through Ray


def main() -> None:
    """Answer one request."""
    requester = Requester()
    try:
        try:
            for reply in _run(requester.receive()):
                requester.send(reply)
            requester.send({"end": True})
        except DuoSpaceNetError as error:
            requester.send(error_reply(error))
    except (KeyboardInterrupt, BrokenPipeError):
        sys.exit(INTERRUPTED_EXIT_CODE)


def _run(request: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """Yield the replies of the actors. Raises the DuoSpaceNetError of an actor."""
    import ray
    import ray.data

    from .ray_actor import SceneActor

    _connect(request)
    try:
        threads = request["settings"]["threads"]
        _check_threads(threads)
        workers = request["workers"] or max(1, int(ray.cluster_resources().get("CPU", 1)) // threads)
        workers = min(workers, len(request["scenes"]))
        context = ray.data.DataContext.get_current()
        context.enable_progress_bars = False
        context.max_errored_blocks = -1  # a scene without a reply fails alone
        # One scene in flight: an actor that is lost then costs no scene that only waited for it. Ray starts lost actors
        # again and repeats their tasks without a limit; `SceneJob` counts the tries.
        pool = ray.data.ActorPoolStrategy(
            min_size=1, max_size=workers, initial_size=workers, max_tasks_in_flight_per_actor=1
        )
        rows = [{"scene": json.dumps(scene)} for scene in request["scenes"]]
        home = request["home"] if request["address"] == LOCAL else ""
        replies = ray.data.from_items(rows, override_num_blocks=len(rows)).map(
            SceneActor,  # type: ignore[arg-type]  # a class whose objects are called
            fn_constructor_args=(request["settings"], home),
            compute=pool,
            num_cpus=threads,
        )
        for row in replies.iter_rows():
            reply = json.loads(row["reply"])
            check_reply(reply)
            yield reply
    finally:
        ray.shutdown()
        if request["address"] == LOCAL:  # here too: the process that created the folder may have been killed
            shutil.rmtree(request["folder"], ignore_errors=True)


def _check_threads(threads: int) -> None:
    """Check that a machine of the cluster has as many cores: Ray would wait for one. Raises UsageError."""
    import ray

    cores = max((node["Resources"].get("CPU", 0) for node in ray.nodes() if node["Alive"]), default=0)
    if 0 < cores < threads:  # a cluster that starts machines on demand may have none yet
        raise UsageError(
            f"--threads: expected at most {cores:g}, the cores of the cluster's largest machine; got {threads}."
        )


def _connect(request: dict[str, Any]) -> None:
    """Start Ray on this machine, or connect to a cluster. Raises UsageError."""
    import ray

    options: dict[str, Any] = {"log_to_driver": False, "logging_level": "ERROR"}
    if request["address"] == LOCAL:
        options |= {"num_cpus": request["cores"], "include_dashboard": False, "_temp_dir": request["folder"]}
        options |= {"object_store_memory": OBJECT_STORE_BYTES}
    try:
        ray.init(address=request["address"], **options)
    except Exception as error:  # ConnectionError, RuntimeError, ValueError and others
        text = " ".join(str(error).split())[:300]
        raise UsageError(f"--ray: expected a Ray cluster at {request['address']}; got none ({text}).") from error


if __name__ == "__main__":
    main()
