"""Inference: a bundle runs over a source, and every frame's detections are written to a folder."""

from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ..data.nuscenes_submission import SubmissionOptions, check_sample_tokens, write_submission
from ..data.results import ResultsFile, drop_partial_line, frame_result, read_results, write_masks
from ..data.source import Source
from ..runtime import Pipeline, Stream
from ..runtime.bundle.manifest import MANIFEST_NAME, read_manifest, sha256
from ..runtime.cores import available_cores
from ..runtime.engine import Engine, choose_engine
from ..runtime.errors import OutputError, UsageError
from ..runtime.lost_cameras import MissingCameraPolicy, check_missing_camera_policy
from ..runtime.peak_memory import peak_memory_gb
from ..runtime.progress import Progress, no_progress
from ..runtime.versions import library_versions
from .frame_rate import note_fast_stream
from .frame_writers import open_frame_writers
from .heatmaps import HeatmapRecorder
from .history_step import check_history_step
from .input_warnings import InputWarnings, InputWatch
from .models import optional_path
from .notify import Notify, ignore
from .output_folder import check_not_source
from .pictures import PictureOptions
from .prefetch import prefetch
from .processed_frame import ProcessedFrame
from .recordings import check_recordable, check_recording
from .run_folder import (
    RESULTS_NAME,
    SUBMISSION_NAME,
    RunSettings,
    check_run_folder,
    find_resumable,
    open_run_folder,
    recover_run_folder,
)
from .run_progress import RunProgress
from .scene_labels import SceneLabels
from .source_check import check_source
from .sources import SourceNames, open_sources, source_names

FORMATS = ("jsonl", "nuscenes")
MAX_TIMINGS = 1000  # the medians are over the newest frames
_LIBRARIES = ("duospacenet", "onnxruntime", "opencv", "simplejpeg", "numpy")  # their versions decide a result's bytes


@dataclass(frozen=True)
class RunSummary:
    """The result of a run.

    frames: frames in the results, skipped ones included.
    degraded: frames from which queries or map cells with non-finite numbers were dropped.
    skipped: frames that were not processed.
    engine: name, version and precision of the library that ran the graphs.
    median_ms: median time of each stage per frame.
    peak_memory_gb: peak memory of the process.
    warnings: what is unusual about the source, as `check-rig` would say it.
    """

    out: Path
    frames: int
    boxes: int
    degraded: int
    skipped: int
    median_ms: dict[str, float]
    peak_memory_gb: float
    engine: Mapping[str, str]
    warnings: tuple[str, ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """The fields as JSON values."""
        return {**vars(self), "out": str(self.out), "engine": dict(self.engine), "warnings": list(self.warnings)}


def run(
    bundle: str | Path,
    sources: SourceNames,
    out: str | Path,
    *,
    draw: bool = False,
    video: bool = False,
    draw_ground_truth: bool = False,
    min_score: float = 0.3,
    heatmaps: bool = False,
    recording: str | Path | None = None,
    maps: bool = False,
    formats: str | Sequence[str] = ("jsonl",),
    submission: SubmissionOptions | None = None,
    on_missing: str = "blank",
    history_step_s: float | None = None,
    threads: int | None = None,
    engine: str = "onnxruntime",
    engine_precision: str = "float32",
    fast_decoding: bool = False,
    overwrite: bool = False,
    resume: bool = False,
    check: bool = True,
    progress: Progress = no_progress,
    notify: Notify = ignore,
) -> RunSummary:
    """Detect the objects in every frame of one or several sources, and write the results to the folder `out`.

    bundle: folder of an exported bundle.
    sources: a scene folder, `trusted:FOLDER`, `nuscenes:ROOT[@VERSION][/SPLIT]` or `synthetic:SEED[:FRAMES]`; or a
        list of sources, which follow one another. The history is reset at each scene.
    draw, video: write one picture per frame, and `video.mp4`.
    draw_ground_truth: draw the source's own boxes too; implies `draw`.
    min_score: detections with a lower score are not drawn or recorded, 0 to 1.
    heatmaps: write the network's features as one picture per frame.
    recording: path of an .mcap file for Foxglove, or an .rrd file for rerun.
    maps: segment the map too, and write its masks.
    formats: "jsonl" is always written; "nuscenes" adds the submission file.
    submission: what the submission file holds, if other than all boxes.
    on_missing: frames with lost cameras are processed ("blank"), skipped ("skip") or refused ("error").
    history_step_s: as for `Pipeline.stream`, for sources that are faster than the data the model was trained on.
    threads: None uses the cores that are available to this process.
    engine, engine_precision: as for `Pipeline.load`.
    fast_decoding: decode JPEG files at a half or a quarter of their size, where the network needs no more.
    overwrite: replace the files of an earlier run in `out`, once this run is complete.
    resume: continue an interrupted run; the files are the same as those of an uninterrupted run.
    check: refuse calibrations that `check-rig` calls broken. Otherwise they are only warned about.
    notify: gets a warning for each unusual property of the source, once. They are in the summary too.
    Raises a DuoSpaceNetError before anything is written if an argument, the bundle, the folder or the source is not
    valid. The pixels of images are only read on the way.
    Raises InputError for an image that cannot be decoded; the frames before it stay in the results.
    """
    bundle, out, policy = Path(bundle), Path(out), check_on_missing(on_missing)
    recording = optional_path(recording)
    pictures = PictureOptions(draw or draw_ground_truth, video, draw_ground_truth, min_score, heatmaps, recording)
    formats = [formats] if isinstance(formats, str) else formats
    chosen_engine = choose_engine(engine, engine_precision)
    _check_options(formats, pictures, overwrite, resume)
    check_submission_options(formats, submission)
    check_run_folder(out, overwrite, resume)
    if recording is not None:
        check_recording(recording, may_replace=overwrite or resume)
    manifest, warnings = read_manifest(bundle), InputWarnings(notify)
    frames = open_sources(sources, fast_decoding=manifest.preprocessing if fast_decoding else None, progress=progress)
    check_history_step(history_step_s, manifest)
    threads = available_cores() if threads is None else threads
    _check_outputs(out, sources, frames, formats, recording)
    settings = run_settings(
        bundle, frames.identity, pictures, maps, policy, threads, chosen_engine, fast_decoding, history_step_s
    )
    recover_run_folder(out, notify)
    if resume:
        find_resumable(out, settings)
    check_source(frames, manifest, warnings, on_missing=policy, refuse_broken=check, progress=progress)
    if history_step_s is None:
        note_fast_stream(frames, manifest.window, notify)
    pipeline = Pipeline.load(bundle, threads, engine=engine, engine_precision=engine_precision)
    recorder = HeatmapRecorder(pipeline) if heatmaps else None
    stream = (recorder.pipeline if recorder else pipeline).stream(maps, policy, history_step_s)
    with open_run_folder(out, settings, overwrite=overwrite, resume=resume, notify=notify) as folder:
        summary = run_stream(
            pipeline,
            stream,
            frames,
            folder,
            formats=formats,
            submission=submission,
            pictures=pictures,
            heatmaps=recorder,
            progress=progress,
            warnings=warnings,
        )
    return replace(summary, out=out)


def run_stream(
    pipeline: Pipeline,
    stream: Stream,
    source: Source,
    out: Path,
    *,
    formats: Sequence[str] = ("jsonl",),
    submission: SubmissionOptions | None = None,
    pictures: PictureOptions | None = None,
    heatmaps: HeatmapRecorder | None = None,
    progress: Progress = no_progress,
    warnings: InputWarnings | None = None,
) -> RunSummary:
    """Run a new stream of the pipeline over a source and write the results to `out`, frame by frame.

    Frames that are in the results already are not processed again.
    heatmaps: of the pipeline on which the stream was opened, to draw its features.
    warnings: gets the findings about stale images and poses.
    """
    warnings = warnings or InputWarnings()
    watch = InputWatch(pipeline.manifest.window, warnings)
    path, timings = out / RESULTS_NAME, deque[Mapping[str, float]](maxlen=MAX_TIMINGS)
    done = _read_progress(path, stream)
    _restore_history(stream, source, done)
    indices = range(done.frames, len(source))
    files = open_frame_writers(out, pictures or PictureOptions(), heatmaps, source, pipeline.manifest, done)
    with ExitStack() as stack:
        writers = stack.enter_context(files)
        results = stack.enter_context(ResultsFile(path))
        frames = stack.enter_context(prefetch(source.frame, indices))
        shown = progress(indices, "run", done=done.frames, label=SceneLabels(source))
        for index, frame in zip(shown, frames, strict=True):
            detections = stream.step(frame)
            result = frame_result(frame, detections, write_masks(out, index, detections.maps))
            for writer in writers:
                writer.add(ProcessedFrame(index, frame, detections, result))
            done.add(result)
            results.write(result)  # last: a line in the results means that all files of the frame are written
            watch.add(index, frame)
            if detections.skipped is None:
                timings.append(detections.timings_s)
    if "nuscenes" in formats:
        write_submission(out / SUBMISSION_NAME, read_results(path), submission)
    watch.complete()
    return replace(_summary(out, done, timings, pipeline), warnings=tuple(warnings.texts))


def run_settings(
    bundle: Path,
    source_identity: str,
    pictures: PictureOptions,
    maps: bool,
    on_missing: MissingCameraPolicy,
    threads: int,
    engine: Engine,
    fast_decoding: bool,
    history_step_s: float | None,
) -> RunSettings:
    """The settings of a run, for `run.json`. The arguments are those of `run`; the threads are a number."""
    drawing: RunSettings = {"truth": pictures.ground_truth} if pictures.draw else {}
    drawing |= {"min_score": pictures.min_score or 0.0} if pictures.draw or pictures.heatmaps else {}
    return {
        "bundle": f"{MANIFEST_NAME}, sha256 {sha256(bundle / MANIFEST_NAME)}",
        "source": source_identity,
        "maps": maps,
        "draw": pictures.draw,
        "heatmaps": pictures.heatmaps,
        **drawing,
        "on_missing": on_missing,
        "threads": threads,
        "engine": engine.name,
        "engine_precision": engine.precision,
        **library_versions((*_LIBRARIES, engine.name)),
        "fast_decoding": fast_decoding,
        "history_step_s": "newest frames" if history_step_s is None else history_step_s,
    }


def check_on_missing(on_missing: str) -> MissingCameraPolicy:
    """Check the name of a policy for lost cameras. Raises UsageError that names the option."""
    try:
        return check_missing_camera_policy(on_missing)
    except UsageError as error:
        raise UsageError(f"--on-missing: {str(error).partition(': ')[2]}") from None


def check_formats(formats: Sequence[str]) -> None:
    """Check the names of output formats. Raises UsageError."""
    if unknown := [name for name in formats if name not in FORMATS]:
        raise UsageError(f"--format: expected {' or '.join(FORMATS)}; got {unknown[0]!r}.")


def check_submission_options(formats: Sequence[str], submission: SubmissionOptions | None) -> None:
    """Check the options of a submission. Raises UsageError."""
    if submission is None:
        return
    if "nuscenes" not in formats:
        raise UsageError("options of the submission: expected --format nuscenes too; got no submission to write.")
    submission.check()


def _check_options(formats: Sequence[str], pictures: PictureOptions, overwrite: bool, resume: bool) -> None:
    check_formats(formats)
    if overwrite and resume:
        raise UsageError("expected either --overwrite or --resume; got both.")
    if resume and pictures.video and not pictures.draw:
        raise UsageError(
            "--resume --video: expected --draw too, in this call and in the interrupted one: the video is made from "
            "the pictures."
        )


def _check_outputs(
    out: Path, sources: SourceNames, frames: Source, formats: Sequence[str], recording: Path | None
) -> None:
    """Check that no source is replaced, and that the files of the run can represent its frames."""
    for name in source_names(sources):
        check_not_source(out, name)
    if "nuscenes" in formats:
        check_sample_tokens(frames.tokens)
    if recording is not None:
        check_recordable(frames)


def _read_progress(path: Path, stream: Stream) -> RunProgress:
    """Count the frames that are in the results already. Removes an incomplete last line, left by a killed run."""
    done = RunProgress(stream.selection)
    drop_partial_line(path)
    for result in read_results(path):
        done.add(result)
    return done


def _restore_history(stream: Stream, source: Source, done: RunProgress) -> None:
    """Process the frames of the next frame's window again, so that the stream has the same cached values as before."""
    for index, timestamp_s in reversed(done.history):
        frame = source.frame(index) if index < len(source) else None
        if frame is None or frame.timestamp_s != timestamp_s:
            raise OutputError(
                f"{RESULTS_NAME}: line {index + 1} is not a frame of this source. Start again with --overwrite."
            )
        stream.step(frame)


def _summary(out: Path, done: RunProgress, timings: Iterable[Mapping[str, float]], pipeline: Pipeline) -> RunSummary:
    rows = list(timings)
    stages = rows[0] if rows else {}
    median_ms = {stage: round(1000 * float(np.median([row[stage] for row in rows])), 3) for stage in stages}
    memory_gb = round(peak_memory_gb(), 2)
    counts = done.frames, done.boxes, done.degraded, done.skipped
    return RunSummary(out, *counts, median_ms, memory_gb, pipeline.engine)
