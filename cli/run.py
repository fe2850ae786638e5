"""`duospacenet run`: frames in, boxes out, on a CPU and without torch."""

import shutil
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from rich.table import Table

from ..runtime import Detections, Frame, Pipeline
from ..runtime.drawing import VideoWriter, draw_frame
from ..runtime.errors import OutputError, UsageError
from ..runtime.images import write_png
from ..runtime.results import JsonLines, NuScenesSubmission
from ..runtime.sources import Source, open_source
from .console import print_json, results, track

FORMATS = ("jsonl", "nuscenes")


def run(
    bundle: Annotated[Path, typer.Argument(help="A bundle's folder.")],
    source: Annotated[str, typer.Argument(help="synthetic:SEED[:FRAMES], or a scene folder.")],
    out: Annotated[Path, typer.Option(help="Folder for the results.")],
    draw: Annotated[bool, typer.Option("--draw", help="A picture a frame: cameras and bird's-eye view.")] = False,
    video: Annotated[bool, typer.Option("--video", help="The pictures as video.mp4 too.")] = False,
    draw_truth: Annotated[bool, typer.Option("--draw-truth", help="Draw the source's own boxes, in green.")] = False,
    maps: Annotated[bool, typer.Option("--maps", help="Segment the map, and draw it.")] = False,
    format: Annotated[str, typer.Option(help="jsonl, nuscenes, or both with a comma.")] = "jsonl",
    min_score: Annotated[float, typer.Option(help="Boxes below it are not drawn.", min=0, max=1)] = 0.3,
    threads: Annotated[int | None, typer.Option(help="Default: the cores this process may use.", min=1)] = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Remove what an earlier run left in --out.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="A summary as one JSON object.")] = False,
) -> None:
    """Detect the objects of every frame of a source."""
    formats = parse_formats(format)
    frames = open_source(source)
    pipeline = Pipeline.load(bundle, threads)
    prepare_folder(out, overwrite)
    pictures = Pictures(draw=draw or draw_truth, video=video, truth=draw_truth, min_score=min_score)
    summary = run_source(pipeline, frames, out, formats, pictures, maps)
    print_json(summary.to_dict()) if as_json else summary.print()


@dataclass(frozen=True)
class Pictures:
    """Which pictures are wanted. predictions: draw the detections of at least `min_score`."""

    draw: bool = False
    video: bool = False
    truth: bool = False
    predictions: bool = True
    min_score: float = 0.3


@dataclass(frozen=True)
class Summary:
    """What a run did: the folder, its frames, and the median milliseconds a stage."""

    out: Path
    frames: int
    boxes: int
    degraded: int
    median_ms: dict[str, float]

    def to_dict(self) -> dict:
        return {**vars(self), "out": str(self.out)}

    def print(self) -> None:
        table = Table("stage", "median ms")
        for stage, milliseconds in self.median_ms.items():
            table.add_row(stage, f"{milliseconds:.1f}")
        results.print(table)
        results.print(f"{self.frames} frames, {self.boxes} boxes; results in {self.out}", markup=False)


def run_source(
    pipeline: Pipeline, source: Source, out: Path, formats: tuple[str, ...], pictures: Pictures, maps: bool
) -> Summary:
    """Stream a source through a pipeline and write what was asked for to `out`, frame by frame."""
    timings: list[dict[str, float]] = []
    boxes = degraded = 0
    submission = NuScenesSubmission() if "nuscenes" in formats else None
    with ExitStack() as stack:
        lines = stack.enter_context(JsonLines(out / "results.jsonl")) if "jsonl" in formats else None
        album = stack.enter_context(Album(out, pictures, pipeline)) if pictures.draw or pictures.video else None
        for frame, detections in _detect(pipeline, source, maps):
            if lines:
                lines.write(detections)
            if submission:
                submission.add(frame, detections)
            if album:
                album.add(frame, detections)
            timings.append(dict(detections.timings_s))
            boxes, degraded = boxes + len(detections), degraded + detections.degraded
    if submission:
        submission.write(out / "results_nusc.json")
    return Summary(out, len(timings), boxes, degraded, _medians_ms(timings))


class Album:
    """The pictures of a run: `pictures/000000.png`, one a frame, and `video.mp4`."""

    def __init__(self, out: Path, pictures: Pictures, pipeline: Pipeline) -> None:
        self._out, self._pictures = out, pictures
        self._range_m = max(abs(bound) for bound in pipeline.manifest.perception.upper_m[:2])
        self._start_s: float | None = None
        self._count = 0
        self._stack = ExitStack()
        self._video = self._stack.enter_context(VideoWriter(out / "video.mp4")) if pictures.video else None

    def __enter__(self) -> "Album":
        return self

    def __exit__(self, *exception: object) -> None:
        self._stack.__exit__(*exception)  # type: ignore[arg-type]

    def add(self, frame: Frame, detections: Detections) -> None:
        """Draw one frame and write it."""
        self._start_s = frame.timestamp_s if self._start_s is None else self._start_s
        kept = np.flatnonzero(detections.scores >= (self._pictures.min_score if self._pictures.predictions else 2))
        picture = draw_frame(
            frame,
            detections.boxes[kept],
            [detections.classes[index] for index in kept],
            detections.scores[kept],
            truth=frame.truth if self._pictures.truth else None,
            maps=detections.maps,
            range_m=self._range_m,
            start_s=self._start_s,
        )
        if self._pictures.draw:
            write_png(self._out / "pictures" / f"{self._count:06d}.png", picture)
        if self._video:
            self._video.write(picture)
        self._count += 1


def parse_formats(text: str) -> tuple[str, ...]:
    """The value of --format. Raises UsageError."""
    formats = tuple(part.strip() for part in text.split(","))
    unknown = [part for part in formats if part not in FORMATS]
    if unknown:
        raise UsageError(f"--format: expected {' or '.join(FORMATS)}; got {unknown[0]!r}.")
    return formats


def prepare_folder(out: Path, overwrite: bool) -> None:
    """Make `out`, with none of an earlier run's results in it. Raises OutputError."""
    written = [out / name for name in ("results.jsonl", "results_nusc.json", "video.mp4", "pictures")]
    there = [path for path in written if path.exists()]
    if there and not overwrite:
        raise OutputError(f"{there[0]}: an earlier run wrote it. Choose another --out, or add --overwrite.")
    try:
        for path in there:
            shutil.rmtree(path) if path.is_dir() else path.unlink()
        (out / "pictures").mkdir(parents=True)
    except OSError as error:
        raise OutputError(f"{out}: cannot be written ({error.strerror}). Choose another --out.") from error


def _detect(pipeline: Pipeline, source: Source, maps: bool) -> Iterator[tuple[Frame, Detections]]:
    stream = pipeline.stream(maps=maps)
    for frame in track(source, "run", total=len(source)):
        yield frame, stream.step(frame)


def _medians_ms(timings: list[dict[str, float]]) -> dict[str, float]:
    stages = timings[0] if timings else {}
    return {stage: round(1000 * float(np.median([row[stage] for row in timings])), 3) for stage in stages}
