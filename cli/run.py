"""`duospacenet run`: frames in, boxes out, on a CPU and without torch."""

from collections import deque
from collections.abc import Iterable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from rich.table import Table

from ..data.nuscenes_submission import check_sample_tokens, write_submission
from ..data.results import ResultsFile, drop_partial_line, frame_result, read_results, write_masks
from ..data.source import Source
from ..jobs.output_folder import (
    RESULTS_NAME,
    SUBMISSION_NAME,
    Job,
    check_apart,
    check_job,
    check_run_folder,
    run_folder,
)
from ..jobs.pictures import Pictures, PictureWriter
from ..jobs.run_progress import RunProgress
from ..jobs.sources import open_source
from ..runtime import Pipeline, Stream
from ..runtime.bundle.manifest import MANIFEST_NAME, read_manifest, sha256
from ..runtime.cores import available_cores
from ..runtime.errors import OutputError, UsageError
from ..runtime.lost_cameras import MissingCameraPolicy, check_missing_camera_policy
from .console import peak_memory_gb, print_json, print_result, show_progress

FORMATS = ("jsonl", "nuscenes")
PACKAGES = ("duospacenet", "onnxruntime", "opencv-python-headless", "numpy")  # that make the bytes of a result
MOST_TIMINGS = 1000  # frames that the medians are of, the last ones


def run(
    bundle: Annotated[Path, typer.Argument(help="A bundle's folder.")],
    source: Annotated[str, typer.Argument(help="synthetic:SEED[:FRAMES], or a scene folder.")],
    out: Annotated[Path, typer.Option(help="Folder for the results.")],
    draw: Annotated[bool, typer.Option("--draw", help="A picture a frame: cameras and bird's-eye view.")] = False,
    video: Annotated[bool, typer.Option("--video", help="The pictures as video.mp4 too.")] = False,
    draw_truth: Annotated[bool, typer.Option("--draw-truth", help="Draw the source's own boxes, in green.")] = False,
    maps: Annotated[bool, typer.Option("--maps", help="Segment the map: masks in maps/, and drawn.")] = False,
    format: Annotated[
        str, typer.Option(help="jsonl; nuscenes writes the submission too, from results.jsonl.")
    ] = "jsonl",
    min_score: Annotated[float, typer.Option(help="Boxes below it are not drawn.", min=0, max=1)] = 0.3,
    on_missing: Annotated[
        str, typer.Option(help="A frame of lost cameras: blank them, skip the frame, or end with an error.")
    ] = "blank",
    threads: Annotated[int | None, typer.Option(help="Default: the cores this process may use.", min=1)] = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Remove what an earlier run left in --out.")] = False,
    resume: Annotated[bool, typer.Option("--resume", help="Go on where the same run broke off.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="A summary as one JSON object.")] = False,
) -> None:
    """Detect the objects of every frame of a source."""
    formats, policy = parse_formats(format), check_missing_camera_policy(on_missing)
    pictures = Pictures(draw or draw_truth, video, draw_truth, min_score)
    _check_options(pictures, overwrite, resume)
    check_run_folder(out, overwrite, resume)
    frames, threads = open_source(source), available_cores() if threads is None else threads
    check_apart(out, source)
    if "nuscenes" in formats:
        check_sample_tokens(frames.tokens)
    read_manifest(bundle)
    job = _job(bundle, frames, pictures, maps, policy, threads)
    if resume:
        check_job(out, job)
    pipeline = Pipeline.load(bundle, threads)
    stream = pipeline.stream(maps, policy)
    with run_folder(out, job, resume):
        summary = run_source(pipeline, stream, frames, out, formats, pictures)
    if as_json:
        print_json(summary.to_dict())
    else:
        summary.print()


@dataclass(frozen=True)
class Summary:
    """What a run did: the folder, its frames, those without an answer, the median milliseconds a stage, the most
    memory it held.
    """

    out: Path
    frames: int
    boxes: int
    degraded: int
    skipped: int
    median_ms: dict[str, float]
    peak_memory_gb: float

    def to_dict(self) -> dict:
        return {**vars(self), "out": str(self.out)}

    def print(self) -> None:
        table = Table("stage", "median ms")
        for stage, milliseconds in self.median_ms.items():
            table.add_row(stage, f"{milliseconds:.1f}")
        print_result(table)
        answers = {"skipped": self.skipped, "degraded": self.degraded}
        left_out = "".join(f" ({number} {what})" for what, number in answers.items() if number)
        counts = f"{self.frames} frames{left_out}, {self.boxes} boxes, {self.peak_memory_gb:.1f} GB at the most"
        print_result(f"{counts}; results in {self.out}", markup=False)


def run_source(
    pipeline: Pipeline, stream: Stream, source: Source, out: Path, formats: tuple[str, ...], pictures: Pictures
) -> Summary:
    """Drive a new stream of the pipeline over a source and write what was asked for to `out`, frame by frame.

    The frames that stand in `out` already are not looked at again. A frame's line is written last: it says that the
    frame is done.
    """
    path, timings = out / RESULTS_NAME, deque[Mapping[str, float]](maxlen=MOST_TIMINGS)
    tally = RunProgress(pipeline.manifest.window.num_frames)
    drop_partial_line(path)
    for record in read_results(path):
        tally.add(record)
    _warm_up(stream, source, tally)
    with ExitStack() as stack:
        album = (
            stack.enter_context(PictureWriter(out, pictures, _range_m(pipeline), tally)) if pictures.wanted else None
        )
        lines = stack.enter_context(ResultsFile(path))
        for index in show_progress(range(tally.frames, len(source)), "run"):
            frame = source.frame(index)
            detections = stream.step(frame)
            record = frame_result(frame, detections, write_masks(out, index, detections.maps))
            if album:
                album.add(index, frame, detections)
            tally.add(record)
            lines.write(record)
            if detections.skipped is None:
                timings.append(detections.timings_s)
    if "nuscenes" in formats:
        write_submission(out / SUBMISSION_NAME, read_results(path))
    return Summary(
        out,
        tally.frames,
        tally.boxes,
        tally.degraded,
        tally.skipped,
        _medians_ms(timings),
        round(peak_memory_gb(), 2),
    )


def parse_formats(text: str) -> tuple[str, ...]:
    """The value of --format. Raises UsageError."""
    formats = tuple(part.strip() for part in text.split(","))
    unknown = [part for part in formats if part not in FORMATS]
    if unknown:
        raise UsageError(f"--format: expected {' or '.join(FORMATS)}; got {unknown[0]!r}.")
    return formats


def _check_options(pictures: Pictures, overwrite: bool, resume: bool) -> None:
    if overwrite and resume:
        raise UsageError("expected either --overwrite or --resume; got both.")
    if resume and pictures.video and not pictures.draw:
        raise UsageError("--resume --video: expected --draw too, now and before: the video is made from the pictures.")


def _job(
    bundle: Path, source: Source, pictures: Pictures, maps: bool, on_missing: MissingCameraPolicy, threads: int
) -> Job:
    drawn = {"truth": pictures.ground_truth, "min_score": pictures.min_score or 0.0} if pictures.draw else {}
    return {
        "bundle": f"{MANIFEST_NAME}, sha256 {sha256(bundle / MANIFEST_NAME)}",
        "source": source.identity,
        "maps": maps,
        "draw": pictures.draw,
        **drawn,
        "on_missing": on_missing,
        "threads": threads,
        **{package: version(package) for package in PACKAGES},
    }


def _warm_up(stream: Stream, source: Source, tally: RunProgress) -> None:
    """Look again at the frames that the next one looks back to: the memory is then as it was."""
    for index, timestamp_s in tally.looked_at:
        frame = source.frame(index) if index < len(source) else None
        if frame is None or frame.timestamp_s != timestamp_s:
            raise OutputError(f"{RESULTS_NAME}: line {index + 1} is not of this source. Start anew with --overwrite.")
        stream.step(frame)


def _medians_ms(timings: Iterable[Mapping[str, float]]) -> dict[str, float]:
    rows = list(timings)
    stages = rows[0] if rows else {}
    return {stage: round(1000 * float(np.median([row[stage] for row in rows])), 3) for stage in stages}


def _range_m(pipeline: Pipeline) -> float:
    return max(abs(bound) for bound in pipeline.manifest.perception.upper_m[:2])
