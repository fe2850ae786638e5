"""Checks of the ground-truth boxes of a recording: names, sizes, headings and centres."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

from ..data.class_names import DETECTION_CLASSES, count_unknown
from ..runtime.frame import Frame, GroundTruth
from .box_centres import MISTAKES as FRAME_CAUSES
from .box_centres import centre_findings, centres_not_judged
from .box_headings import heading_findings, headings_not_judged
from .box_sizes import size_findings
from .findings import Finding, NotJudged, Verdict
from .image_checks import ImagePlan
from .labelled_frame import LabelledFrame
from .recording import Recording
from .requirements import RigRequirements

MAX_NAMES = 5  # that a finding lists
LEAST_BOXES = 5


@dataclass(frozen=True)
class BoxChecks:
    """The result of the checks. has_boxes: whether the boxes of some of the checked frames are known."""

    has_boxes: bool
    findings: tuple[Finding, ...]
    not_judged: tuple[NotJudged, ...]


def check_boxes(
    recording: Recording, frames: Sequence[Frame], plan: ImagePlan, requirements: RigRequirements, poses_are_right: bool
) -> BoxChecks:
    """Check the ground-truth boxes of some frames.

    poses_are_right: whether the times and poses have no finding.
    """
    indices = plan.labelled if recording.has_fast_ground_truth else plan.checked
    found = [(index, recording.ground_truth(index)) for index in indices]
    known = [(index, ground_truth) for index, ground_truth in found if ground_truth is not None]
    labelled = [LabelledFrame.of(index, frames[index], each) for index, each in known if index in plan.valid]
    findings = (*name_findings(known, requirements.classes), *box_findings(labelled, poses_are_right))
    return BoxChecks(bool(known), findings, tuple(boxes_not_judged(labelled)))


def box_findings(frames: Sequence[LabelledFrame], poses_are_right: bool = True) -> list[Finding]:
    """Findings about the boxes of some frames, in order of time.

    If the sizes or the frame of reference are wrong, what follows from them is not reported.
    """
    sizes = list(size_findings(frames))
    centres = [] if sizes else list(centre_findings(frames, poses_are_right))
    is_other_frame = any(finding.cause in FRAME_CAUSES for finding in centres)
    return [*sizes, *([] if is_other_frame else heading_findings(frames)), *centres]


def boxes_not_judged(frames: Sequence[LabelledFrame]) -> list[NotJudged]:
    """What could not be judged about the boxes; nothing if there is no ground truth."""
    num_boxes = sum(len(frame.boxes) for frame in frames)
    if not frames:
        return []
    if num_boxes < LEAST_BOXES:
        return [NotJudged("ground-truth boxes", f"only {num_boxes} in the {len(frames)} checked frames")]
    return [*headings_not_judged(frames), *centres_not_judged(frames)]


def name_findings(
    ground_truths: Sequence[tuple[int, GroundTruth]], classes: Sequence[str] | None = None
) -> list[Finding]:
    """A finding if boxes have names that `eval` and `train` refuse.

    ground_truths: with the indices of their frames.
    classes: of the model; the ten classes of nuScenes if None.
    """
    unknown, frames = Counter[str](), []
    for index, ground_truth in ground_truths:
        found = count_unknown(ground_truth.classes, classes or DETECTION_CLASSES, ground_truth.class_mapping)
        unknown += found
        if found:
            frames.append(index)
    if not unknown:
        return []
    listed = ", ".join(f"{name!a} ({count})" for name, count in unknown.most_common(MAX_NAMES))
    more = f" and {len(unknown) - MAX_NAMES} more names" if len(unknown) > MAX_NAMES else ""
    return [
        Finding(
            "class names",
            Verdict.BROKEN,
            f"names of {', '.join(classes or DETECTION_CLASSES)}, or categories of nuScenes",
            f"{unknown.total()} boxes with other names: {listed}{more}",
            "The names are those of another data set. `eval` and `train` refuse them.",
            "Rename them, or map them with class_mapping in scene.json.",
            frames[0],
            len(frames),
        )
    ]
