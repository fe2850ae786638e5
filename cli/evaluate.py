"""`duospacenet eval`: how good a bundle's answers are, by nuScenes' rules."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated

import typer

from ..data.source import Source
from ..evaluation import EvaluationReport, Sample, evaluate
from ..evaluation.protocol import CLASSES
from ..jobs.detectors import Detector, check_options, eager_detector, onnx_detector
from ..jobs.sources import open_source
from ..runtime.bundle.manifest import MANIFEST_NAME, Manifest, read_manifest
from ..runtime.errors import ArtifactError, InputError, OutputError
from ..runtime.extras import needs_extra
from .console import print_json, show_progress
from .options import AnchorsOption, WeightsOption
from .score_table import print_scores


def evaluate_bundle(
    bundle: Annotated[Path, typer.Argument(help="A bundle's folder.")],
    source: Annotated[
        list[str], typer.Argument(help="synthetic:SEED[:FRAMES], or a scene folder with true boxes; one or more.")
    ],
    single_frame: Annotated[
        bool, typer.Option("--single-frame", help="Every frame as if it were the first: no temporal window.")
    ] = False,
    limit: Annotated[int | None, typer.Option(help="Only the first frames of each source.", min=1)] = None,
    eager: Annotated[bool, typer.Option("--eager", help="The model in PyTorch instead, with --weights.")] = False,
    weights: WeightsOption = None,
    anchors: AnchorsOption = None,
    threads: Annotated[int | None, typer.Option(help="Default: the cores this process may use.", min=1)] = None,
    plots: Annotated[
        Path | None, typer.Option(help="New folder for precision.png and errors.png. Needs the extra viz.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="All numbers as one JSON object.")] = False,
) -> None:
    """Compare a bundle's answers with the truth of sources: AP, the five errors, NDS and the IoU of maps."""
    check_options(eager, weights, anchors, threads)
    if plots is not None:
        check_plots(plots)
    manifest = read_manifest(bundle)
    check_classes(bundle, manifest)
    sources = [_open(spec, manifest) for spec in source]
    if eager:
        assert weights is not None  # check_options
        detector = eager_detector(bundle, manifest, weights, anchors)
    else:
        detector = onnx_detector(bundle, threads)
    report = evaluate(samples(detector, sources, single_frame, limit))
    if as_json:
        asked = {"bundle": str(bundle), "sources": [one.identity for one in sources], "eager": eager}
        print_json(asked | {"single_frame": single_frame} | report.to_dict())
    else:
        print_scores(report)
    if plots is not None:
        write_plots(plots, report)


def samples(
    detector: Detector, sources: Sequence[Source], single_frame: bool = False, limit: int | None = None
) -> Iterator[Sample]:
    """Drive a detector over sources, one after the other, and pair its answers with the truth.

    Frames whose true boxes are not known are looked at, for the sake of the next, and not judged. limit: of frames of
    each source.
    """
    drive = [(source, index) for source in sources for index in range(len(source))[:limit]]
    for source, index in show_progress(drive, "eval"):
        if index == 0 or single_frame:
            detector.reset()
        frame = source.frame(index)
        detections = detector.step(frame)
        if frame.ground_truth is not None and frame.ground_truth.has_boxes:
            yield Sample(detections, frame.ground_truth)


def check_classes(bundle: Path, manifest: Manifest) -> None:
    """Raises ArtifactError for a bundle of classes that nuScenes' benchmark does not have."""
    unknown = [name for name in manifest.classes if name not in CLASSES]
    if unknown:
        raise ArtifactError(
            f"{bundle / MANIFEST_NAME}: field classes: expected classes of nuScenes' benchmark, {', '.join(CLASSES)}; "
            f"got {unknown[0]!r}. Such a bundle cannot be judged by it."
        )


def check_plots(folder: Path) -> None:
    """See that plots can be made, before the hours of an evaluation. Raises MissingExtraError, OutputError."""
    with needs_extra("viz"):
        from ..evaluation.plots import check_new
    check_new(folder)
    if not folder.absolute().parent.is_dir():
        raise OutputError(f"--plots: expected a place in a folder that is there; got {folder}. Make its parent first.")


def write_plots(folder: Path, report: EvaluationReport) -> None:
    from ..evaluation import plots

    plots.write_plots(folder, report)


def _open(spec: str, manifest: Manifest) -> Source:
    """A source that has true boxes; the maps of a drawn drive are drawn on the bundle's own grid.

    Raises InputError where no frame has true boxes.
    """
    source = open_source(spec, manifest.perception.size[:2])
    if not any(map(source.has_boxes, range(len(source)))):
        raise InputError(
            f"{spec}: expected true boxes to compare with, at least in one frame; got none. Add `boxes` to the frames."
        )
    return source
