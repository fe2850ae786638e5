"""The records of a batch that pass between processes and into files, as JSON."""

from dataclasses import dataclass

from pydantic import Field

from ...runtime.json_record import JsonRecord
from ...runtime.lost_cameras import MissingCameraPolicy
from ..run_folder import RunSettings


@dataclass(frozen=True)
class BatchSettings:
    """The settings of every worker. The fields are JSON values; those without a comment are arguments of `jobs.run`.

    It is no pydantic record, because those refuse paths that are not valid UTF-8.

    bundle, out: absolute paths.
    run_settings: of `run.json`, without the source. A worker with other library versions is refused.
    call: a text that no other call of `batch` has.
    """

    bundle: str
    out: str
    call: str
    run_settings: RunSettings
    maps: bool
    on_missing: MissingCameraPolicy
    history_step_s: float | None
    threads: int
    engine: str
    engine_precision: str
    fast_decoding: bool
    check: bool


class SceneOutcome(JsonRecord):
    """The result of one scene: a line in `summary.json`, and the `summary.json` of the scene's own folder.

    source: its name, printable.
    folder: of its results, relative to the folder of the batch; of a failed scene, of the frames before the failure.
    status: "done" or "failed".
    cause: why it failed, else None.
    frames: in its results. new_frames: of them, those that the last try has processed.
    degraded, skipped, median_ms, peak_memory_gb, warnings: as in the summary of `run`.
    seconds: duration of the last try.
    tries: more than 1 if a worker process ended while it processed the scene.
    worker: name of the worker that ended the scene.
    """

    scene: str
    source: str
    folder: str
    status: str
    cause: str | None = None
    frames: int = 0
    new_frames: int = 0
    boxes: int = 0
    degraded: int = 0
    skipped: int = 0
    seconds: float = 0.0
    tries: int = 1
    worker: str = ""
    median_ms: dict[str, float] = Field(default_factory=dict)
    peak_memory_gb: float = 0.0
    warnings: tuple[str, ...] = ()

    @property
    def is_done(self) -> bool:
        """Whether the scene is complete."""
        return self.status == "done"
