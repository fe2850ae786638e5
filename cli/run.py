"""`duospacenet run`: frames in, boxes out, on a CPU and without torch."""

from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from rich.table import Table

from ..runtime import Detections, Frame, Pipeline
from ..runtime.errors import UsageError
from ..runtime.manifest import read_manifest
from ..runtime.results import JsonLines, NuScenesSubmission, write_masks
from ..runtime.sources import Source, open_source
from .album import Album, Pictures
from .console import peak_memory_gb, print_json, results, track
from .folder import prepare_folder

FORMATS = ("jsonl", "nuscenes")


def run(
    bundle: Annotated[Path, typer.Argument(help="A bundle's folder.")],
    source: Annotated[str, typer.Argument(help="synthetic:SEED[:FRAMES], or a scene folder.")],
    out: Annotated[Path, typer.Option(help="Folder for the results.")],
    draw: Annotated[bool, typer.Option("--draw", help="A picture a frame: cameras and bird's-eye view.")] = False,
    video: Annotated[bool, typer.Option("--video", help="The pictures as video.mp4 too.")] = False,
    draw_truth: Annotated[bool, typer.Option("--draw-truth", help="Draw the source's own boxes, in green.")] = False,
    maps: Annotated[bool, typer.Option("--maps", help="Segment the map: masks in maps/, and drawn.")] = False,
    format: Annotated[str, typer.Option(help="jsonl, nuscenes, or both with a comma.")] = "jsonl",
    min_score: Annotated[float, typer.Option(help="Boxes below it are not drawn.", min=0, max=1)] = 0.3,
    threads: Annotated[int | None, typer.Option(help="Default: the cores this process may use.", min=1)] = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Remove what an earlier run left in --out.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="A summary as one JSON object.")] = False,
) -> None:
    """Detect the objects of every frame of a source."""
    formats = parse_formats(format)
    frames = open_source(source)
    read_manifest(bundle)
    prepare_folder(out, overwrite)
    pictures = Pictures(draw or draw_truth, video, draw_truth, min_score)
    summary = run_source(Pipeline.load(bundle, threads), frames, out, formats, pictures, maps)
    if as_json:
        print_json(summary.to_dict())
    else:
        summary.print()


@dataclass(frozen=True)
class Summary:
    """What a run did: the folder, its frames, the median milliseconds a stage, the most memory it held."""

    out: Path
    frames: int
    boxes: int
    degraded: int
    median_ms: dict[str, float]
    peak_memory_gb: float

    def to_dict(self) -> dict:
        return {**vars(self), "out": str(self.out)}

    def print(self) -> None:
        table = Table("stage", "median ms")
        for stage, milliseconds in self.median_ms.items():
            table.add_row(stage, f"{milliseconds:.1f}")
        results.print(table)
        counts = f"{self.frames} frames, {self.boxes} boxes, {self.peak_memory_gb:.1f} GB at the most"
        results.print(f"{counts}; results in {self.out}", markup=False)


def run_source(
    pipeline: Pipeline, source: Source, out: Path, formats: tuple[str, ...], pictures: Pictures, maps: bool
) -> Summary:
    """Stream a source through a pipeline and write what was asked for to `out`, frame by frame."""
    timings: list[dict[str, float]] = []
    boxes = degraded = 0
    submission = NuScenesSubmission() if "nuscenes" in formats else None
    with ExitStack() as stack:
        lines = stack.enter_context(JsonLines(out / "results.jsonl")) if "jsonl" in formats else None
        album = stack.enter_context(Album(out, pictures, _range_m(pipeline))) if pictures.wanted else None
        for frame, detections in _detect(pipeline, source, maps):
            masks = write_masks(out, len(timings), detections.maps)
            if lines:
                lines.write(detections, masks)
            if submission:
                submission.add(frame, detections)
            if album:
                album.add(frame, detections)
            timings.append(dict(detections.timings_s))
            boxes, degraded = boxes + len(detections), degraded + detections.degraded
    if submission:
        submission.write(out / "results_nusc.json")
    return Summary(out, len(timings), boxes, degraded, _medians_ms(timings), round(peak_memory_gb(), 2))


def parse_formats(text: str) -> tuple[str, ...]:
    """The value of --format. Raises UsageError."""
    formats = tuple(part.strip() for part in text.split(","))
    unknown = [part for part in formats if part not in FORMATS]
    if unknown:
        raise UsageError(f"--format: expected {' or '.join(FORMATS)}; got {unknown[0]!r}.")
    return formats


def _detect(pipeline: Pipeline, source: Source, maps: bool) -> Iterator[tuple[Frame, Detections]]:
    stream = pipeline.stream(maps=maps)
    for frame in track(source, "run", total=len(source)):
        yield frame, stream.step(frame)


def _medians_ms(timings: list[dict[str, float]]) -> dict[str, float]:
    stages = timings[0] if timings else {}
    return {stage: round(1000 * float(np.median([row[stage] for row in timings])), 3) for stage in stages}


def _range_m(pipeline: Pipeline) -> float:
    return max(abs(bound) for bound in pipeline.manifest.perception.upper_m[:2])
