"""The job of a batch: a bundle runs over one scene. The same code runs in local processes and in Ray actors."""

import time
from collections.abc import Callable, Iterable, Iterator
from functools import lru_cache
from pathlib import Path
from typing import Any

import cv2

from ...data.one_scene import OneScene
from ...data.results import drop_partial_line, read_results
from ...data.source import Source
from ...runtime import Pipeline
from ...runtime.bundle.manifest import read_manifest
from ...runtime.engine import choose_engine
from ...runtime.errors import DuoSpaceNetError, InputError, OutputError, UsageError
from ...runtime.json_record import read_json
from ...runtime.printable import printable
from ..frame_rate import note_fast_stream
from ..inference import RunSummary, run_settings, run_stream
from ..input_warnings import InputWarnings
from ..pictures import PictureOptions
from ..run_folder import RESULTS_NAME, RunSettings, open_run_folder, read_run_settings
from ..source_check import check_source
from ..sources import open_source, with_fast_decoding
from .batch_folder import SCENES, SUMMARY_NAME, UNFINISHED, SceneFolders
from .batch_records import BatchSettings, SceneOutcome
from .scene_list import Scene

MAX_TRIES = 3  # of a scene whose worker process ends each time

ReportFrames = Callable[[int], None]  # gets the number of the scene's frames that are in its results


class SceneJob:
    """Runs scenes, one after the other, with one loaded bundle. Each scene starts a new stream."""

    def __init__(self, settings: BatchSettings, worker: str) -> None:
        """worker: its name, for the outcomes.

        Raises DuoSpaceNetError if the bundle cannot be loaded, or if this process has other library versions than the
        one that began the batch.
        """
        self._settings, self._worker = settings, worker
        self._bundle, self._out = Path(settings.bundle), Path(settings.out)
        self._manifest = read_manifest(self._bundle)
        _check_same_libraries(settings, self._run_settings("").items())
        cv2.setNumThreads(settings.threads)
        engine, precision = settings.engine, settings.engine_precision
        self._pipeline = Pipeline.load(self._bundle, settings.threads, engine=engine, engine_precision=precision)
        self._pipeline.stream(settings.maps, settings.on_missing, settings.history_step_s)  # raises as for every scene
        self._open_source = lru_cache(maxsize=2)(self._open)

    def run(self, scene: Scene, report: ReportFrames = lambda frames: None) -> SceneOutcome:
        """Run a scene, or continue it after another process was killed. Never raises an Exception.

        A scene that has been begun `MAX_TRIES` times without an end is not begun again.
        """
        folders, start_s, tries = SceneFolders(self._out, scene.folder), time.monotonic(), 1
        try:
            if folders.finished.exists():  # its worker was killed after the last step
                return read_json(folders.finished / SUMMARY_NAME, SceneOutcome, OutputError)
            if scene.error is not None:
                raise InputError(scene.error)
            tries += folders.count_try(self._settings.call)
            if tries > MAX_TRIES:
                return self._failed(scene, f"its worker process ended in each of {MAX_TRIES} tries", MAX_TRIES)
            counter = _FrameCounter(report)
            summary = self._run(scene, folders, counter)
            seconds = time.monotonic() - start_s
            outcome = self._done(scene, summary, counter.new_frames, seconds, tries)
            folders.finish(outcome.model_dump(mode="json"))
            return outcome
        except DuoSpaceNetError as error:
            return self._failed(scene, str(error), tries, time.monotonic() - start_s)
        except Exception as error:
            text = f"internal error: {type(error).__name__}: {error}"
            return self._failed(scene, text, tries, time.monotonic() - start_s)

    def _run(self, scene: Scene, folders: SceneFolders, counter: "_FrameCounter") -> RunSummary:
        """Do what `jobs.run` does with one source, with the pipeline that is loaded already."""
        settings, window = self._settings, self._manifest.window
        source = OneScene(self._open_source(scene.source), scene.piece)
        if scene.identity != source.identity:
            raise InputError(f"{scene.source}: expected the same data as when the batch began; it has changed.")
        warnings = InputWarnings()
        check_source(source, self._manifest, warnings, on_missing=settings.on_missing, refuse_broken=settings.check)
        if settings.history_step_s is None:
            note_fast_stream(source, window, warnings.texts.append)
        stream = self._pipeline.stream(settings.maps, settings.on_missing, settings.history_step_s)
        run_json = self._run_settings(source.identity)
        if read_run_settings(folders.unfinished) != run_json or not _has_frames_of(source, folders.unfinished):
            folders.discard_unfinished()
        with open_run_folder(folders.unfinished, run_json, resume=True) as folder:
            return run_stream(self._pipeline, stream, source, folder, progress=counter.progress, warnings=warnings)

    def _open(self, name: str) -> Source:
        source = open_source(name, checked=False)  # `check_source` checks the frames of the scene
        return with_fast_decoding(source, self._manifest.preprocessing) if self._settings.fast_decoding else source

    def _run_settings(self, identity: str) -> RunSettings:
        return batch_run_settings(self._settings, identity)

    def _done(self, scene: Scene, summary: RunSummary, new_frames: int, seconds: float, tries: int) -> SceneOutcome:
        return SceneOutcome(
            scene=scene.scene_id,
            source=printable(scene.source),
            folder=f"{SCENES}/{scene.folder}",
            status="done",
            frames=summary.frames,
            new_frames=new_frames,
            boxes=summary.boxes,
            degraded=summary.degraded,
            skipped=summary.skipped,
            seconds=round(seconds, 3),
            tries=tries,
            worker=self._worker,
            median_ms=summary.median_ms,
            peak_memory_gb=summary.peak_memory_gb,
            warnings=summary.warnings,
        )

    def _failed(self, scene: Scene, cause: str, tries: int, seconds: float = 0.0) -> SceneOutcome:
        return SceneOutcome(
            scene=scene.scene_id,
            source=printable(scene.source),
            folder=f"{UNFINISHED}/{scene.folder}",
            status="failed",
            cause=printable(cause),
            seconds=round(seconds, 3),
            tries=tries,
            worker=self._worker,
        )


def batch_run_settings(settings: BatchSettings, identity: str) -> RunSettings:
    """The settings of the run of one scene, as `run` writes them. identity: of the scene as a source."""
    return run_settings(
        Path(settings.bundle),
        identity,
        PictureOptions(),
        settings.maps,
        settings.on_missing,
        settings.threads,
        choose_engine(settings.engine, settings.engine_precision),
        settings.fast_decoding,
        settings.history_step_s,
    )


def _has_frames_of(source: Source, unfinished: Path) -> bool:
    """Whether the results of an unfinished run are the first frames of a source, apart from an incomplete last line."""
    path = unfinished / RESULTS_NAME
    drop_partial_line(path)
    try:
        times_s = [result["timestamp_s"] for result in read_results(path)]
    except OutputError:  # a damaged line
        return False
    frames = (source.frame_without_images(index) for index in range(min(len(times_s), len(source))))
    return times_s == [frame.timestamp_s for frame in frames]


class _FrameCounter:
    """Counts the frames of a run, and reports each."""

    def __init__(self, report: ReportFrames) -> None:
        self.new_frames = 0
        self._report = report

    def progress(
        self, items: Iterable[Any], description: str, total: int | None = None, *, done: int = 0, label: Any = None
    ) -> Iterator[Any]:
        """Yield the items; a `runtime.progress.Progress`."""
        self._report(done)
        for item in items:
            yield item
            self.new_frames += 1
            self._report(done + self.new_frames)


def _check_same_libraries(settings: BatchSettings, own: Iterable[tuple[str, Any]]) -> None:
    """Check the versions of a worker: results of a batch come from the same libraries. Raises UsageError."""
    for name, value in own:
        if name != "source" and settings.run_settings.get(name) != value:
            raise UsageError(
                f"worker: expected {name} {settings.run_settings.get(name)!r}, as where the batch was started; got "
                f"{value!r}. Install the same versions on all machines."
            )
