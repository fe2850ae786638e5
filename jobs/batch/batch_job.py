"""Batch: a bundle runs over many scenes, and each scene gets a folder of results."""

import secrets
import time
from collections.abc import Generator, Sequence
from contextlib import closing
from dataclasses import replace
from itertools import chain
from pathlib import Path

from ...data.nuscenes_submission import SubmissionOptions, write_submission
from ...data.results import read_results
from ...runtime.bundle.manifest import read_manifest
from ...runtime.cores import available_cores, check_thread_count
from ...runtime.engine import choose_engine
from ...runtime.errors import OutputError, UsageError
from ...runtime.files import write_atomically
from ...runtime.json_record import read_json
from ...runtime.progress import Progress, no_progress
from ..history_step import check_history_step
from ..inference import check_formats, check_on_missing, check_submission_options
from ..notify import Notify, ignore
from ..output_folder import check_not_source
from ..run_folder import RESULTS_NAME, SUBMISSION_NAME
from ..sources import SourceNames, source_names
from .batch_events import BatchEvent
from .batch_folder import (
    SCENES,
    SUMMARY_NAME,
    check_batch_folder,
    check_finished_run,
    check_known_folders,
    check_resumable,
    finished_folders,
    open_batch_folder,
    to_json,
)
from .batch_progress import BatchProgress
from .batch_records import BatchSettings, SceneOutcome
from .batch_summary import BatchSummary
from .ray_pool import check_ray, run_on_ray
from .scene_job import batch_run_settings
from .scene_list import Scene, find_scenes
from .worker_pool import run_in_processes

MAX_WORKERS = 1024


def run_batch(
    bundle: str | Path,
    sources: SourceNames,
    out: str | Path,
    *,
    workers: int | None = None,
    ray: str | None = None,
    threads: int = 1,
    maps: bool = False,
    formats: str | Sequence[str] = ("jsonl",),
    submission: SubmissionOptions | None = None,
    on_missing: str = "blank",
    history_step_s: float | None = None,
    engine: str = "onnxruntime",
    engine_precision: str = "float32",
    fast_decoding: bool = False,
    resume: bool = False,
    check: bool = True,
    progress: Progress = no_progress,
    notify: Notify = ignore,
) -> BatchSummary:
    """Detect the objects in every frame of every scene of the sources. One scene is processed by one worker.

    Each scene is a separate run: `out/scenes/NAME` has the files that `run` writes for this scene alone, and its
    `summary.json`. `out/summary.json` is about all scenes. A scene that cannot be processed fails alone, and is in the
    summary with its cause.

    workers: processes on this machine, or actors of Ray. None: as many as the cores allow.
    ray: None for processes on this machine; "local" starts Ray on this machine for this call; "auto" or HOST:PORT
        connects to a Ray cluster.
    threads: per worker. It may change the last bits of results, so it does not follow from the number of workers.
    formats: "jsonl" is always written; "nuscenes" adds one submission of all scenes, `out/results_nusc.json`, if no
        scene has failed.
    resume: continue an interrupted batch; finished scenes are not processed again, and failed ones are tried again.
    bundle, sources, submission, on_missing, history_step_s, engine, engine_precision, fast_decoding, check: as for
        `run`.
    Raises a DuoSpaceNetError before any scene is processed if an argument, the bundle, the folder or the name of a
    source is not valid.
    """
    start_s, bundle, out = time.monotonic(), Path(bundle), Path(out)
    formats = [formats] if isinstance(formats, str) else formats
    names = source_names(sources)
    _check_numbers(workers, threads)
    check_formats(formats)
    check_submission_options(formats, submission)
    policy, chosen_engine = check_on_missing(on_missing), choose_engine(engine, engine_precision)
    if ray is not None:
        check_ray(ray)
    check_batch_folder(out, resume)
    for name in names:
        check_not_source(out, name)
    manifest = read_manifest(bundle)
    check_history_step(history_step_s, manifest)
    scenes = find_scenes(names, check_tokens="nuscenes" in formats, progress=progress, notify=notify)
    settings = BatchSettings(
        bundle=str(bundle.absolute()),
        out=str(out.absolute()),
        call=secrets.token_hex(8),
        run_settings={},
        maps=maps,
        on_missing=policy,
        history_step_s=history_step_s,
        threads=threads,
        engine=chosen_engine.name,
        engine_precision=chosen_engine.precision,
        fast_decoding=fast_decoding,
        check=check,
    )
    common = {name: value for name, value in batch_run_settings(settings, "").items() if name != "source"}
    settings = replace(settings, run_settings=common)
    check_resumable(out, common)
    _find_finished(out, scenes, settings)
    with open_batch_folder(out, common, resume=resume, notify=notify):
        finished = _find_finished(out, scenes, settings)
        followed = BatchProgress(scenes, finished, notify)
        left = [scene for scene in scenes if scene.scene_id not in finished]
        left.sort(key=lambda scene: -scene.piece.frames)  # no worker begins a long scene when the others are done
        if left:
            with closing(_run_scenes(settings, left, workers, ray)) as events:
                followed.show(events, progress)
        outcomes = [followed.outcomes[scene.scene_id] for scene in scenes]
        has_submission = "nuscenes" in formats and _write_submission(out, scenes, outcomes, submission, notify)
        new = {scene.scene_id for scene in left}
        summary = BatchSummary(out, outcomes, new, followed.lost_workers, time.monotonic() - start_s, has_submission)
        write_atomically(summary.path, to_json(summary.to_dict()))
    return summary


def _check_numbers(workers: int | None, threads: int) -> None:
    check_thread_count(threads)
    if workers is not None and not 1 <= workers <= MAX_WORKERS:
        raise UsageError(f"--workers: expected 1 to {MAX_WORKERS}; got {workers}.")


def _find_finished(out: Path, scenes: Sequence[Scene], settings: BatchSettings) -> dict[str, SceneOutcome]:
    """Return the outcomes of the scenes that are finished already. Raises UsageError for scenes of another batch."""
    folders = finished_folders(out)
    check_known_folders(out, folders, [scene.folder for scene in scenes])
    outcomes = {}
    for scene in scenes:
        if scene.folder in folders:
            if scene.error is not None:
                raise UsageError(f"--resume: {scene.error} Its results are in {out / SCENES / scene.folder}.")
            check_finished_run(out, scene.folder, {**settings.run_settings, "source": scene.identity})
            path = out / SCENES / scene.folder / SUMMARY_NAME
            outcomes[scene.scene_id] = read_json(path, SceneOutcome, OutputError)
    return outcomes


def _run_scenes(
    settings: BatchSettings, scenes: Sequence[Scene], workers: int | None, ray: str | None
) -> Generator[BatchEvent, None, None]:
    local_workers = workers or max(1, available_cores() // settings.threads)
    if ray is None:
        return run_in_processes(settings, scenes, local_workers)
    return run_on_ray(settings, scenes, workers, ray, cores=local_workers * settings.threads)


def _write_submission(
    out: Path,
    scenes: Sequence[Scene],
    outcomes: Sequence[SceneOutcome],
    options: SubmissionOptions | None,
    notify: Notify,
) -> bool:
    """Write the submission of all scenes in order. Returns whether it could be written."""
    if not all(outcome.is_done for outcome in outcomes):
        notify(f"{SUBMISSION_NAME} is not written: a submission needs the frames of all scenes, and some have failed.")
        return False
    paths = [out / SCENES / scene.folder / RESULTS_NAME for scene in scenes]
    write_submission(out / SUBMISSION_NAME, chain.from_iterable(map(read_results, paths)), options)
    return True
