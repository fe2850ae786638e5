"""Local workers: processes that take scenes from one queue. A lost process costs the scene that it was processing."""

import os
import queue
import threading
from collections import deque
from collections.abc import Generator, Iterator, Sequence

from ...runtime.errors import ArtifactError
from .batch_events import BatchEvent, SceneEnded, SceneFrames, WorkerLost
from .batch_records import BatchSettings, SceneOutcome
from .child_process import ChildProcess, ProcessLostError
from .scene_list import Scene

MAX_LOST_AT_START = 3  # processes that end, one after the other, before they have loaded the bundle
END_S = 15.0  # for the frame in progress of a worker


def run_in_processes(
    settings: BatchSettings, scenes: Sequence[Scene], workers: int
) -> Generator[BatchEvent, None, None]:
    """Run scenes in `workers` processes, and yield what happens. Close the iterator to end the processes.

    Raises the DuoSpaceNetError of a worker that cannot load the bundle.
    """
    pool = _WorkerPool(settings, scenes, min(workers, len(scenes)))
    try:
        yield from pool.events()
    finally:
        pool.end()


class _WorkerPool:
    """One thread for each worker: it starts the process, gives it scenes, and passes its replies on as events."""

    def __init__(self, settings: BatchSettings, scenes: Sequence[Scene], workers: int) -> None:
        self._settings = settings
        self._events: queue.SimpleQueue[BatchEvent | BaseException | None] = queue.SimpleQueue()
        self._lock = threading.Lock()  # of the four fields below
        self._scenes = deque(scenes)
        self._processes: dict[str, ChildProcess] = {}
        self._lost_at_start = 0
        self._ending = False
        names = [f"worker {number}" for number in range(1, workers + 1)]
        self._threads = [threading.Thread(target=self._serve, args=(name,), name=name, daemon=True) for name in names]

    def events(self) -> Iterator[BatchEvent]:
        """Start the workers, and yield their events until all scenes have ended. Raises the exception of a worker."""
        for thread in self._threads:
            thread.start()
        for _ in self._threads:
            while (event := self._events.get()) is not None:
                if isinstance(event, BaseException):
                    raise event
                yield event

    def end(self) -> None:
        """End all workers."""
        with self._lock:
            self._ending = True
            processes = list(self._processes.values())
        for process in processes:
            process.end()
        for process in processes:
            process.wait(END_S)
        for thread in self._threads:
            if thread.ident is not None:  # it was started
                thread.join()

    def _serve(self, name: str) -> None:
        """Run scenes until there are no more. The last event is None or an exception."""
        process = None
        try:
            while (scene := self._next_scene()) is not None:
                process = process or self._start(name)
                if process is None:
                    break
                try:
                    self._run(process, scene)
                except ProcessLostError as error:
                    self._put_back(name, scene, str(error))
                    process.close()
                    process = None
            self._events.put(None)
        except BaseException as error:
            self._events.put(error)
        finally:
            if process is not None:
                process.end()
                process.wait(END_S)
                process.close()

    def _run(self, process: ChildProcess, scene: Scene) -> None:
        process.send(scene.to_dict())
        while "frames" in (reply := process.receive()):
            self._events.put(SceneFrames(scene.scene_id, reply["frames"]))
        self._events.put(SceneEnded(scene.scene_id, SceneOutcome.model_validate(reply["outcome"])))

    def _start(self, name: str) -> ChildProcess | None:
        """Start a process, and wait until it has loaded the bundle. Returns None if the pool ends.

        Raises ArtifactError if processes end before that again and again.
        """
        while True:
            with self._lock:
                if self._ending:
                    return None
                process = self._processes[name] = ChildProcess("worker", [name], self._environment())
            try:
                process.send(vars(self._settings))
                process.receive()  # it has loaded the bundle
            except ProcessLostError as error:
                process.close()
                self._count_lost_at_start(str(error))
            except BaseException:
                process.close()
                raise
            else:
                with self._lock:
                    self._lost_at_start = 0
                return process

    def _environment(self) -> dict[str, str]:
        """The variables of a process whose numerical libraries also use its share of the cores."""
        names = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
        return os.environ | dict.fromkeys(names, str(self._settings.threads))

    def _count_lost_at_start(self, cause: str) -> None:
        with self._lock:
            self._lost_at_start += 1
            if self._lost_at_start >= MAX_LOST_AT_START and not self._ending:
                raise ArtifactError(
                    f"{self._settings.bundle}: {self._lost_at_start} worker processes ended while they loaded it "
                    f"({cause}). Use fewer --workers if memory is short."
                )

    def _next_scene(self) -> Scene | None:
        with self._lock:
            return self._scenes.popleft() if self._scenes and not self._ending else None

    def _put_back(self, name: str, scene: Scene, cause: str) -> None:
        """Let the next free worker do a scene again, usually this one."""
        with self._lock:
            self._scenes.appendleft(scene)
            ending = self._ending
        if not ending:
            self._events.put(WorkerLost(name, scene.scene_id, cause))
