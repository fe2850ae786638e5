"""Checks of the images of some frames: file by file, and compared with each other and with the poses."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

from ..runtime.frame import Frame
from ..runtime.progress import Progress
from .calibration import image_findings
from .camera_pairs import same_image_findings
from .compared_frames import compared_frames, pairs_of_frames
from .findings import Finding, NotJudged
from .image_comparison import ImageComparison
from .motion import is_valid_header
from .motion_steps import MotionStep
from .pose_mistakes import large_unit
from .recording import CameraImage, Recording, evenly_spaced
from .requirements import RigRequirements

LEAST_FRAMES_TO_COMPARE = 4  # requested frames with images; with fewer, only these are compared
CameraFinding = tuple[str, Finding]  # with the camera's name


class ImageSizes(NamedTuple):
    """Two sizes, width and height, of one camera in one frame.

    image_px: of the image file; None if there is no readable image.
    calibration_px: according to the calibration.
    """

    image_px: tuple[int, int] | None
    calibration_px: tuple[int, int]


@dataclass(frozen=True)
class ImagePlan:
    """The frames whose images are read, as indices.

    checked: all of them, in order.
    compared: those whose images are compared with each other.
    labelled: those whose boxes are checked, if this is fast.
    valid: the frames of the recording with a valid time and pose.
    shown: by camera, the frames that may be shown in the report.
    """

    checked: Sequence[int]
    compared: frozenset[int]
    labelled: Sequence[int]
    valid: frozenset[int]
    shown: Mapping[str, Sequence[int]]


@dataclass(frozen=True)
class ImageChecks:
    """The result of the checks.

    findings: with the camera's name.
    drive_findings: about the poses, or all cameras together.
    sizes: by index of the frame, then by camera.
    shown: by camera, the index and the image of the frame to show.
    """

    findings: Sequence[CameraFinding]
    drive_findings: Sequence[Finding]
    not_judged: Sequence[NotJudged]
    sizes: Mapping[int, Mapping[str, ImageSizes]]
    shown: Mapping[str, tuple[int, CameraImage]]


def plan_image_checks(
    frames: Sequence[Frame], requirements: RigRequirements, num_frames: int, shown: Mapping[str, Sequence[int]]
) -> ImagePlan:
    """Choose the frames whose images are read.

    num_frames: number of evenly spaced frames.
    shown: by camera, the frames of which the first is added.
    """
    valid = [index for index, frame in enumerate(frames) if is_valid_header(frame, requirements)]
    evenly = evenly_spaced(len(frames), num_frames)
    if num_frames >= LEAST_FRAMES_TO_COMPARE:
        compared = {valid[position] for position in compared_frames([frames[index] for index in valid])}
    else:
        compared = set(evenly) & set(valid)
    checked = sorted({*evenly, *compared, *(indices[0] for indices in shown.values())})
    pairs = {valid[position] for position in pairs_of_frames([frames[index] for index in valid])}
    return ImagePlan(checked, frozenset(compared), sorted({*checked, *pairs}), frozenset(valid), shown)


def check_images(
    recording: Recording,
    frames: Sequence[Frame],
    requirements: RigRequirements,
    plan: ImagePlan,
    usable: Sequence[str],
    poses_are_right: bool,
    progress: Progress,
) -> ImageChecks:
    """Read and check the images of the planned frames.

    usable: names of the cameras whose calibrations have no finding.
    poses_are_right: whether the times and poses have no finding.
    """
    comparison = ImageComparison(requirements, usable, plan.compared)
    findings: list[CameraFinding] = []
    sizes: dict[int, dict[str, ImageSizes]] = {}
    shown: dict[str, tuple[int, CameraImage]] = {}
    for index in progress(plan.checked, "pictures"):
        images = recording.camera_images(index)
        sizes[index] = _image_sizes(frames[index], images)
        findings += [(name, replace(each, frame=index)) for name, each in _image_findings(frames[index], images)]
        for name, image in images.items():
            if index in plan.shown[name] and (name not in shown or shown[name][1].image is None):
                shown[name] = index, image
        if index in plan.valid:
            comparison.add(index, frames[index], {name: image.valid_image for name, image in images.items()})
    wrong = {name for name, finding in findings if finding.subject == "image"}
    cameras, drive, not_judged = comparison.findings(poses_are_right, wrong)
    findings += [each for each in cameras if not (each[0] in wrong and each[1].subject.startswith("image compared"))]
    return ImageChecks(findings, drive, not_judged, sizes, shown)


def unexplained_findings(
    findings: Sequence[Finding], motion: Sequence[Finding], steps: Sequence[MotionStep]
) -> Iterator[Finding]:
    """Yield the findings about the drive from images and resets that the findings from times and poses do not explain.

    motion: findings from times and poses.
    """
    for finding in findings:
        if finding.subject == "ego pose":
            unit = large_unit(steps)
            finding = replace(finding, cause=f"Likely cause: the positions are in {unit}.") if unit else finding
            if any(each.subject == "ego pose" for each in motion):
                continue
        elif motion:
            continue
        yield finding


def _image_sizes(frame: Frame, images: Mapping[str, CameraImage]) -> dict[str, ImageSizes]:
    return {
        name: ImageSizes(images.get(name, CameraImage()).size_px, (camera.width_px, camera.height_px))
        for name, camera in frame.cameras.items()
    }


def _image_findings(frame: Frame, images: Mapping[str, CameraImage]) -> Iterator[CameraFinding]:
    for name, image in images.items():
        for finding in image_findings(image, frame.cameras[name]):
            yield name, finding
    yield from same_image_findings(images)
