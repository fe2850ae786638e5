"""The examination of a rig: all calibrations, times and poses of a recording, the images and boxes of some frames."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

from ..runtime.frame import Camera, Frame
from ..runtime.progress import Progress, no_progress
from .blind_sectors import Sector, find_blind_sectors
from .calibration import CheckedCalibration, calibration_bytes
from .coverage import Coverage, compute_coverage
from .findings import Finding, NotJudged, Verdict, merge_findings, worst_verdict
from .frame_calibration import FrameCalibration, judge_calibration
from .ground_truth_checks import check_boxes
from .image_checks import ImageSizes, check_images, plan_image_checks, unexplained_findings
from .motion import MOTION_CHECKS, frame_findings, motion_not_judged, step_findings, steps_between
from .motion_steps import MotionStep
from .recording import CameraImage, Recording
from .requirements import RigRequirements
from .turned_cameras import turned_camera_findings

# Findings that explain a blind sector, or that say which camera is turned.
POSE_SUBJECTS = ("pose", "direction", "camera_T_ego", "direction in the images")

FrameFindings = list[tuple[int, Finding]]  # of one camera, each with the index of its frame
Calibrations = Mapping[str, CheckedCalibration]  # of one frame, by camera


@dataclass(frozen=True)
class CameraView:
    """One camera's findings over all frames, and its calibration and image in one frame, for the report.

    frame: index of the first frame with the camera's worst calibration. Frames with an image are preferred.
    camera, camera_image: calibration and image in that frame.
    findings: of all frames.
    num_calibrations: number of distinct calibrations in the recording.
    is_usable: whether this calibration is not broken, regardless of findings about images or other cameras.
    """

    frame: int
    camera: Camera
    camera_image: CameraImage
    findings: tuple[Finding, ...]
    num_calibrations: int
    is_usable: bool

    @property
    def verdict(self) -> Verdict:
        """The most severe verdict of the camera's findings."""
        return worst_verdict(self.findings)


@dataclass(frozen=True)
class Examination:
    """The result of an examination.

    views: by camera.
    image_sizes: by index of the frame, then by camera, for the frames with checked images.
    motion_findings: about times and ego poses, and about all cameras together.
    box_findings: about the ground-truth boxes. has_boxes: whether there are any.
    not_judged: the checks for which there was too little evidence.
    coverage, blind_sectors: of the cameras with a usable calibration in their views.
    """

    requirements: RigRequirements
    num_frames: int
    views: Mapping[str, CameraView]
    image_sizes: Mapping[int, Mapping[str, ImageSizes]]
    motion_findings: tuple[Finding, ...]
    box_findings: tuple[Finding, ...]
    has_boxes: bool
    not_judged: tuple[NotJudged, ...]
    steps: tuple[MotionStep, ...]
    coverage: Coverage
    blind_sectors: tuple[Sector, ...]

    @property
    def motion_verdict(self) -> Verdict:
        """The most severe verdict of the findings about times and ego poses; "not judged" for too short a drive."""
        is_short = any(not each.cameras and each.check in MOTION_CHECKS for each in self.not_judged)
        return worst_verdict(self.motion_findings) if self.motion_findings or not is_short else Verdict.NOT_JUDGED

    @property
    def box_verdict(self) -> Verdict:
        """The most severe verdict of the findings about ground-truth boxes; "not judged" if there are no boxes."""
        return worst_verdict(self.box_findings) if self.has_boxes else Verdict.NOT_JUDGED

    @property
    def verdict(self) -> Verdict:
        """The most severe verdict of all findings."""
        camera_findings = (finding for view in self.views.values() for finding in view.findings)
        return worst_verdict([*self.motion_findings, *self.box_findings, *camera_findings])


def examine(
    recording: Recording, requirements: RigRequirements, num_frames: int, progress: Progress = no_progress
) -> Examination:
    """Check all calibrations, times and poses of a recording, and the images and boxes of some frames.

    num_frames: number of frames with checked images, evenly spaced. For each camera, the first frame with its worst
        calibration is added, and a short run of frames whose images are compared with each other.
    progress: shows the progress over the frames.
    """
    frames, calibrations, findings = _check_calibrations(recording, progress)
    worst_frames = {name: _worst_frames(calibrations, name, findings[name]) for name in findings}
    steps = steps_between(frames, requirements)
    motion = [*frame_findings(frames, requirements), *step_findings(steps, requirements, frames[0].timestamp_s)]
    plan = plan_image_checks(frames, requirements, num_frames, worst_frames)
    usable = [name for name in findings if not findings[name]]
    images = check_images(recording, frames, requirements, plan, usable, poses_are_right=not motion, progress=progress)
    for name, finding in images.findings:
        findings[name].append((finding.frame, finding))
    views = {
        name: _build_view(calibrations, name, images.shown.get(name, (worst_frames[name][0], CameraImage())), each)
        for name, each in findings.items()
    }
    views = _with_lost_cameras(views, images.sizes)
    coverage, blind_sectors = _cover(requirements, views)
    drive = [*motion, *unexplained_findings(images.drive_findings, motion, steps)]
    boxes = check_boxes(recording, frames, plan, requirements, poses_are_right=not drive)
    return Examination(
        requirements=requirements,
        num_frames=len(frames),
        views=views,
        image_sizes=images.sizes,
        motion_findings=tuple(drive),
        box_findings=boxes.findings,
        has_boxes=boxes.has_boxes,
        not_judged=(*motion_not_judged(steps, requirements), *images.not_judged, *boxes.not_judged),
        steps=tuple(steps),
        coverage=coverage,
        blind_sectors=blind_sectors,
    )


def _check_calibrations(
    recording: Recording, progress: Progress
) -> tuple[list[Frame], list[Calibrations], dict[str, FrameFindings]]:
    """Read all frames and check their calibrations.

    Returns the frames, their calibrations, and the findings by camera. Equal calibrations are checked only once.
    """
    frames: list[Frame] = []
    calibrations: list[Calibrations] = []
    findings: dict[str, FrameFindings] = {}
    cache: dict[tuple[tuple[str, bytes], ...], FrameCalibration] = {}
    for index in progress(range(len(recording)), "calibrations"):
        frame = recording.frame_without_images(index)
        key = tuple((name, calibration_bytes(camera)) for name, camera in frame.cameras.items())
        if key not in cache:
            cache[key] = judge_calibration(frame.cameras)
        for name, camera_findings in cache[key].findings.items():
            findings.setdefault(name, []).extend((index, finding) for finding in camera_findings)
        frames.append(frame)
        calibrations.append(cache[key].calibrations)
    return frames, calibrations, findings


def _worst_frames(calibrations: list[Calibrations], name: str, findings: FrameFindings) -> list[int]:
    """The indices of the frames with a camera's most severe findings; all its frames if there are no findings."""
    by_frame: dict[int, list[Finding]] = {index: [] for index, frame in enumerate(calibrations) if name in frame}
    for index, finding in findings:
        by_frame[index].append(finding)
    severities = {index: worst_verdict(each).severity for index, each in by_frame.items()}
    return [index for index, severity in severities.items() if severity == max(severities.values())]


def _build_view(
    calibrations: list[Calibrations], name: str, shown: tuple[int, CameraImage], findings: FrameFindings
) -> CameraView:
    index, image = shown
    distinct = {calibration_bytes(frame[name].camera) for frame in calibrations if name in frame}
    calibration = calibrations[index][name]
    merged = tuple(merge_findings(findings))
    return CameraView(index, calibration.camera, image, merged, len(distinct), calibration.is_usable)


def _with_lost_cameras(
    views: dict[str, CameraView], image_sizes: Mapping[int, Mapping[str, ImageSizes]]
) -> dict[str, CameraView]:
    """Add a finding to each camera without an image in all checked frames, unless it already has an image finding."""
    for name, view in views.items():
        has_image = any(name in sizes and sizes[name].image_px for sizes in image_sizes.values())
        if not has_image and not any(finding.subject == "image" for finding in view.findings):
            lost = Finding(
                "image",
                Verdict.SUSPECT,
                "an image in at least one frame",
                f"none in the {len(image_sizes)} checked frames",
                "The camera is lost throughout, or its paths are missing.",
                "Add the paths, or remove the camera.",
            )
            views[name] = _with_finding(view, lost)
    return views


def _cover(requirements: RigRequirements, views: dict[str, CameraView]) -> tuple[Coverage, tuple[Sector, ...]]:
    """The coverage and the blind sectors of the usable cameras. Findings about them are added to the views."""
    grid = requirements.perception, requirements.preprocessing
    usable = {name: view.camera for name, view in views.items() if view.is_usable}
    coverage = compute_coverage(usable, *grid)
    blind_sectors = tuple(find_blind_sectors(usable, *grid))
    for name in usable:
        has_wrong_pose = any(finding.subject in POSE_SUBJECTS for finding in views[name].findings)
        if not coverage.voxels[name].any() and not has_wrong_pose:
            views[name] = _with_finding(views[name], _no_coverage_finding(name))
    if not any(finding.subject in POSE_SUBJECTS for view in views.values() for finding in view.findings):
        for name, finding in turned_camera_findings(usable, blind_sectors, *grid):
            views[name] = _with_finding(views[name], finding)
    return coverage, blind_sectors


def _no_coverage_finding(name: str) -> Finding:
    return Finding(
        "coverage",
        Verdict.SUSPECT,
        "at least one voxel in view",
        f"none in view of {name}",
        "The camera looks away from the perception range, or preprocessing crops that part of its image.",
        "Correct the calibration, or remove the camera.",
    )


def _with_finding(view: CameraView, finding: Finding) -> CameraView:
    findings = sorted((*view.findings, replace(finding, frame=view.frame)), key=lambda each: -each.verdict.severity)
    return replace(view, findings=tuple(findings))
