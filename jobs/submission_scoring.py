"""Scoring of a submission: the detections of any detector, in a nuScenes submission file, against the ground truth."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..data.joined_source import join_sources
from ..data.nuscenes_submission import check_sample_tokens
from ..data.source import Source
from ..data.submission_file import SubmissionFile
from ..evaluation import EvaluationReport, Sample, evaluate
from ..runtime.errors import InputError
from ..runtime.printable import printable, shortened
from ..runtime.progress import Progress, no_progress
from .ground_truth_check import check_true_boxes
from .sources import SourceNames, open_source, source_names

if TYPE_CHECKING:
    from .lost_camera_scores import LostCameraScore  # imports onnxruntime, which a submission does not need

MAX_LISTED_TOKENS = 3


@dataclass(frozen=True)
class SubmissionScores:
    """The scores of a submission.

    sources: the identity of each source.
    meta: the flags `use_camera` and so on of the submission.
    """

    submission: Path
    sources: tuple[str, ...]
    meta: Mapping[str, bool]
    report: EvaluationReport

    @property
    def lost_cameras(self) -> "tuple[LostCameraScore, ...]":
        """Empty: the detector of a file cannot be run with fewer cameras."""
        return ()

    @property
    def subject(self) -> str:
        """The submission and the data that it says it uses, as one line of text."""
        uses = ", ".join(name.removeprefix("use_") for name, is_used in self.meta.items() if is_used)
        return printable(f"submission {self.submission}; its meta says that it uses {uses or 'no data'}")

    def to_dict(self) -> dict[str, Any]:
        """The scores and what they were measured on, as JSON values."""
        measured = {"submission": str(self.submission), "sources": list(self.sources), "meta": dict(self.meta)}
        return measured | self.report.to_dict()


def evaluate_submission(
    submission: str | Path, sources: SourceNames, *, progress: Progress = no_progress
) -> SubmissionScores:
    """Evaluate a nuScenes submission file on sources with ground truth, as nuscenes-devkit 1.2.0 does.

    The submission must have all sample tokens of the sources and no others. Boxes with equal scores are ranked by
    their order in the file. The file is read sample by sample, so it may be larger than the memory.

    sources: one or several sources, as `evaluate_bundle` takes them; usually a split of a nuScenes root.

    Raises InputError for a source without ground truth, and for a submission that the benchmark does not accept.
    """
    file, names = SubmissionFile(Path(submission)), source_names(sources)
    opened = [open_source(name, progress=progress) for name in names]
    for source, name in zip(opened, names, strict=True):
        check_true_boxes(source, name, range(len(source)), "The split `test` of nuScenes has no public annotations.")
    frames = join_sources(opened)
    check_sample_tokens(frames.tokens)
    report = evaluate(progress(submitted_samples(file, frames), "eval", len(frames)))
    if not report.ground_truth.num_of_known_classes:
        raise InputError(
            f"{', '.join(map(str, names))}: expected at least one true box of a detection class; got none. "
            "The scores would say nothing about the submission."
        )
    return SubmissionScores(file.path, tuple(source.identity for source in opened), file.meta or {}, report)


def submitted_samples(file: SubmissionFile, source: Source) -> Iterator[Sample]:
    """Pair the boxes of a submission with the ground truth, in the order of the file.

    Samples of frames without known boxes are read, but not yielded.
    Raises InputError if the file is not a submission for exactly the frames of the source.
    """
    missing = {token: index for index, token in enumerate(source.tokens)}
    for token, submitted in file:
        index = missing.pop(token, None)
        if index is None:
            raise InputError(
                f"{file.path}: expected only sample tokens of the sources; got {shortened(token)}, which they do not "
                "have. Name the split that the submission was made for."
            )
        ground_truth = source.ground_truth_without_maps(index)
        if ground_truth is not None:
            pose = source.frame_without_images(index).global_T_ego
            yield Sample.in_global_frame(submitted, ground_truth, pose)
    if missing:
        listed = ", ".join(shortened(token) for token in list(missing)[:MAX_LISTED_TOKENS])
        raise InputError(
            f"{file.path}: expected each sample token of the sources; {len(missing)} are missing, such as {listed}. "
            "Add them, with an empty list if nothing was detected, or name the split that the submission was made for."
        )
