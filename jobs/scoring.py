"""Scoring: a detector runs over sources, and its detections are compared with the ground truth."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from ..data.source import Source
from ..evaluation import EvaluationReport, Sample, evaluate
from ..runtime import Pipeline
from ..runtime.bundle.manifest import Manifest, read_manifest
from ..runtime.engine import choose_engine
from ..runtime.errors import InputError
from ..runtime.printable import printable
from ..runtime.progress import Progress, no_progress
from .detectors import Detector, check_detector_options, eager_detector
from .frame_rate import note_fast_stream
from .ground_truth_check import check_benchmark_classes, check_ground_truth
from .history_step import check_history_step
from .input_warnings import InputWarnings, InputWatch
from .lost_camera_scores import LostCameraScore, fewest_cameras, score_lost_cameras
from .models import optional_path
from .notify import Notify, ignore
from .prefetch import prefetch
from .scene_labels import SceneLabels
from .source_check import check_source
from .sources import SourceNames, map_grid, open_source, source_names, with_fast_decoding


@dataclass(frozen=True)
class BundleScores:
    """The scores of a bundle.

    sources: the identities of the sources.
    eager: whether the model ran in PyTorch.
    engine: name, version and precision of the library that ran the graphs; None in PyTorch.
    single_frame: whether the history was reset before every frame.
    warnings: what is unusual about the sources, as `check-rig` would say it.
    fast_decoding: whether JPEG files were decoded at a reduced size.
    history_step_s: time between two frames of the temporal window [s]; None for the newest frames.
    lost_cameras: scores with 0, 1, ... cameras lost in every frame; empty unless requested.
    """

    bundle: Path
    sources: tuple[str, ...]
    eager: bool
    single_frame: bool
    report: EvaluationReport
    engine: Mapping[str, str] | None = None
    warnings: tuple[str, ...] = ()
    fast_decoding: bool = False
    history_step_s: float | None = None
    lost_cameras: tuple[LostCameraScore, ...] = ()

    @property
    def subject(self) -> str:
        """The bundle and what ran it, as one line of text."""
        engine = self.engine
        ran = "PyTorch" if engine is None else f"{engine['name']} {engine['version']}, {engine['precision']}"
        return printable(f"bundle {self.bundle}; {ran}")

    def to_dict(self) -> dict[str, Any]:
        """The scores and what they were measured on, as JSON values."""
        measured = {"bundle": str(self.bundle), "sources": list(self.sources), "eager": self.eager}
        measured |= {"single_frame": self.single_frame, "fast_decoding": self.fast_decoding}
        measured["history_step_s"] = self.history_step_s
        measured["warnings"] = list(self.warnings)
        measured |= {"lost_cameras": [score.to_dict() for score in self.lost_cameras]} if self.lost_cameras else {}
        measured["engine"] = None if self.engine is None else dict(self.engine)
        return measured | self.report.to_dict()


def evaluate_bundle(
    bundle: str | Path,
    sources: SourceNames,
    *,
    single_frame: bool = False,
    limit: int | None = None,
    history_step_s: float | None = None,
    eager: bool = False,
    weights: str | Path | None = None,
    anchors: str | Path | None = None,
    threads: int | None = None,
    engine: str = "onnxruntime",
    engine_precision: str = "float32",
    fast_decoding: bool = False,
    lost_cameras: bool = False,
    check: bool = True,
    progress: Progress = no_progress,
    notify: Notify = ignore,
) -> BundleScores:
    """Evaluate a bundle's detections and maps on sources with ground truth, by the rules of nuScenes.

    Sources may have true boxes, true masks or both; the report says how many frames had each. Masks of
    another grid than the bundle's are resampled, see `data.mask_resampling`.

    sources: one or several scene folders, `trusted:FOLDER`, `nuscenes:ROOT[@VERSION][/SPLIT]` or
        `synthetic:SEED[:FRAMES]`.
    single_frame: reset the history before every frame.
    limit: only use the first frames of each source.
    history_step_s: as for `Pipeline.stream`, for sources that are faster than the training data.
    eager: evaluate the model in PyTorch instead, with `weights` and, if it was exported with any, `anchors`.
    threads: None uses the cores that are available to this process.
    engine, engine_precision: as for `Pipeline.load`.
    fast_decoding: decode JPEG files at a half or a quarter of their size, where the network needs no more.
    lost_cameras: evaluate with 1, 2, ... cameras lost in every frame too, see `lost_camera_scores`. Each number costs
        one more evaluation.
    check: refuse calibrations that `check-rig` calls broken. Otherwise they are only warned about.
    notify: gets each warning once.
    Raises ArtifactError for a bundle that cannot be evaluated. Raises InputError for a source without ground truth,
    with class names that are not known, or with frames that the bundle cannot process.
    """
    bundle, weights, anchors = Path(bundle), optional_path(weights), optional_path(anchors)
    check_detector_options(eager, weights, anchors, threads, choose_engine(engine, engine_precision))
    manifest = read_manifest(bundle)
    check_history_step(history_step_s, manifest, eager)
    check_benchmark_classes(bundle, manifest, "The benchmark cannot evaluate this bundle.")
    names = source_names(sources)
    opened = [_open_with_ground_truth(name, manifest, progress) for name in names]
    if fast_decoding:
        opened = [with_fast_decoding(source, manifest.preprocessing) for source in opened]
    warnings, labels = InputWarnings(notify), [str(name) if len(names) > 1 else "" for name in names]
    for source, label in zip(opened, labels, strict=True):
        check_source(source, manifest, warnings, name=label, num_frames=limit, refuse_broken=check, progress=progress)
        if history_step_s is None and not single_frame:
            note_fast_stream(source, manifest.window, notify)
    watches = [InputWatch(manifest.window, warnings, label) for label in labels]
    if eager and weights is not None:
        engine_report, detector = None, eager_detector(bundle, manifest, weights, anchors, notify)
    else:
        pipeline = Pipeline.load(bundle, threads, engine=engine, engine_precision=engine_precision)
        with_maps = "segmenter" in pipeline.sessions
        engine_report, detector = pipeline.engine, pipeline.stream(with_maps, history_step_s=history_step_s)
    samples = partial(detect_samples, sources=opened, single_frame=single_frame, limit=limit, progress=progress)
    report = evaluate(samples(detector, watches=watches))
    _check_informative(report, names, notify)
    lost: tuple[LostCameraScore, ...] = ()
    if lost_cameras:
        _check_lost_cameras(report, names)
        num_cameras = fewest_cameras(opened, limit)
        lost = score_lost_cameras(detector, report, num_cameras, lambda losing: evaluate(samples(losing)))
    return BundleScores(
        bundle=bundle,
        sources=tuple(source.identity for source in opened),
        eager=eager,
        single_frame=single_frame,
        report=report,
        engine=engine_report,
        warnings=tuple(warnings.texts),
        fast_decoding=fast_decoding,
        history_step_s=history_step_s,
        lost_cameras=lost,
    )


def detect_samples(
    detector: Detector,
    sources: Sequence[Source],
    single_frame: bool = False,
    limit: int | None = None,
    progress: Progress = no_progress,
    watches: Sequence[InputWatch] = (),
) -> Iterator[Sample]:
    """Run a detector over one source after the other, and pair its detections with the ground truth.

    Frames without known boxes and masks are processed, because the next frames need their cached values, but not
    evaluated.
    limit: only use the first frames of each source.
    watches: of each source, for warnings about stale input; may be empty.
    """
    places = [(number, index) for number, source in enumerate(sources) for index in range(len(source))[:limit]]
    with prefetch(lambda place: sources[place[0]].frame(place[1]), places) as frames:
        shown = progress(places, "eval", label=_place_labels(sources))
        for (number, index), frame in zip(shown, frames, strict=True):
            if index == 0 or single_frame:
                detector.reset()
            detections = detector.step(frame)
            if watches:
                watches[number].add(index, frame)
            truth = frame.ground_truth
            if truth is not None and (truth.has_boxes or truth.maps):
                yield Sample.of_detections(detections, truth, frame.global_T_ego)
    for watch in watches:
        watch.complete()


def _place_labels(sources: Sequence[Source]) -> Callable[[tuple[int, int]], str]:
    """The label of a frame by the number of its source and its index there."""
    labels = [SceneLabels(source) for source in sources]
    if len(sources) == 1:
        return lambda place: labels[0](place[1])
    return lambda place: f"source {place[0] + 1} of {len(sources)}, {labels[place[0]](place[1])}"


def _open_with_ground_truth(name: str | Path, manifest: Manifest, progress: Progress) -> Source:
    """Open a source with true boxes or masks. Masks of nuScenes and of synthetic scenes are on the bundle's grid."""
    source = open_source(name, map_grid(manifest.perception, manifest.map_classes), progress)
    check_ground_truth(source, name, manifest)
    return source


def _check_informative(report: EvaluationReport, names: Sequence[str | Path], notify: Notify) -> None:
    """Raise InputError for scores that say nothing about the detector."""
    place = ", ".join(map(str, names))
    if not report.num_samples and not report.num_map_samples:
        raise InputError(
            f"{place}: expected true boxes or masks of the bundle's map classes; got none in these frames."
        )
    if report.has_boxes and not report.ground_truth.num_of_known_classes:
        text = f"{place}: expected at least one true box of a detection class; got none."
        if not report.num_map_samples:
            raise InputError(f"{text} The scores would say nothing about the detector.")
        notify(f"warning: {text} Only the scores of the maps say something about the detector.")


def _check_lost_cameras(report: EvaluationReport, names: Sequence[str | Path]) -> None:
    if not report.has_boxes:
        place = ", ".join(map(str, names))
        raise InputError(f"--lost-cameras: expected true boxes; {place} has maps only. Leave the option out.")
