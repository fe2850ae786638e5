"""The examination of a rig: all calibrations, times and poses of a recording, and the images of some frames."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple

from ..runtime.frame import Camera, Frame
from ..runtime.progress import Progress, no_progress
from .blind_sectors import Sector, find_blind_sectors
from .calibration import CheckedCalibration, image_findings
from .camera_pairs import same_image_findings
from .coverage import Coverage, compute_coverage
from .findings import Finding, Verdict, merge_findings, worst_verdict
from .frame_calibration import FrameCalibration, judge_calibration
from .motion import MotionStep, frame_findings, step_findings, steps_between
from .recording import CameraImage, Recording, evenly_spaced
from .requirements import RigRequirements

FrameFindings = list[tuple[int, Finding]]  # of one camera, each with the index of its frame
Calibrations = Mapping[str, CheckedCalibration]  # of one frame, by camera
CameraFinding = tuple[str, Finding]  # with the camera's name


class ImageSizes(NamedTuple):
    """Two sizes, width and height, of one camera in one frame.

    image_px: of the image file; None if there is no readable image.
    calibration_px: according to the calibration.
    """

    image_px: tuple[int, int] | None
    calibration_px: tuple[int, int]


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
    motion_findings: about times and ego poses.
    coverage, blind_sectors: of the cameras with a usable calibration in their views.
    """

    requirements: RigRequirements
    num_frames: int
    views: Mapping[str, CameraView]
    image_sizes: Mapping[int, Mapping[str, ImageSizes]]
    motion_findings: tuple[Finding, ...]
    steps: tuple[MotionStep, ...]
    coverage: Coverage
    blind_sectors: tuple[Sector, ...]

    @property
    def motion_verdict(self) -> Verdict:
        """The most severe verdict of the findings about times and ego poses."""
        return worst_verdict(self.motion_findings)

    @property
    def verdict(self) -> Verdict:
        """The most severe verdict of all findings."""
        camera_findings = (finding for view in self.views.values() for finding in view.findings)
        return worst_verdict([*self.motion_findings, *camera_findings])


def examine(
    recording: Recording, requirements: RigRequirements, num_frames: int, progress: Progress = no_progress
) -> Examination:
    """Check all calibrations, times and poses of a recording, and the images of some frames.

    num_frames: number of frames with checked images, evenly spaced. For each camera, the first frame with its worst
        calibration is added.
    progress: shows the progress over the frames.
    """
    frames, calibrations, findings = _check_calibrations(recording, progress)
    worst_frames = {name: _worst_frames(calibrations, name, findings[name]) for name in findings}
    checked = sorted({*evenly_spaced(len(frames), num_frames), *(indices[0] for indices in worst_frames.values())})
    shown: dict[str, tuple[int, CameraImage]] = {}
    image_sizes: dict[int, dict[str, ImageSizes]] = {}
    for index in progress(checked, "pictures"):
        images = recording.camera_images(index)
        image_sizes[index] = _image_sizes(frames[index], images)
        for name, finding in _image_findings(frames[index], images):
            findings[name].append((index, finding))
        for name, image in images.items():
            if index in worst_frames[name] and (name not in shown or shown[name][1].image is None):
                shown[name] = index, image
    views = {
        name: _build_view(calibrations, name, shown.get(name, (worst_frames[name][0], CameraImage())), findings[name])
        for name in findings
    }
    return _complete_examination(requirements, frames, _with_lost_cameras(views, image_sizes), image_sizes)


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
        key = tuple((name, _to_bytes(camera)) for name, camera in frame.cameras.items())
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


def _image_sizes(frame: Frame, images: Mapping[str, CameraImage]) -> dict[str, ImageSizes]:
    return {
        name: ImageSizes(images.get(name, CameraImage()).size_px, (camera.width_px, camera.height_px))
        for name, camera in frame.cameras.items()
    }


def _image_findings(frame: Frame, images: Mapping[str, CameraImage]) -> Iterable[CameraFinding]:
    for name, image in images.items():
        for finding in image_findings(image, frame.cameras[name]):
            yield name, finding
    yield from same_image_findings(images)


def _build_view(
    calibrations: list[Calibrations], name: str, shown: tuple[int, CameraImage], findings: FrameFindings
) -> CameraView:
    index, image = shown
    distinct = {_to_bytes(frame[name].camera) for frame in calibrations if name in frame}
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


def _complete_examination(
    requirements: RigRequirements,
    frames: list[Frame],
    views: dict[str, CameraView],
    image_sizes: Mapping[int, Mapping[str, ImageSizes]],
) -> Examination:
    """Add the coverage and the checks of the ego motion."""
    grid = requirements.perception, requirements.preprocessing
    usable = {name: view.camera for name, view in views.items() if view.is_usable}
    coverage = compute_coverage(usable, *grid)
    for name in usable:
        if not coverage.voxels[name].any():
            views[name] = _with_finding(views[name], _no_coverage_finding(name))
    steps = steps_between(frames, requirements)
    return Examination(
        requirements=requirements,
        num_frames=len(frames),
        views=views,
        image_sizes=image_sizes,
        motion_findings=(*frame_findings(frames, requirements), *step_findings(steps, requirements)),
        steps=tuple(steps),
        coverage=coverage,
        blind_sectors=tuple(find_blind_sectors(usable, *grid)),
    )


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


def _to_bytes(camera: Camera) -> bytes:
    """The exact numbers of a calibration, as a dictionary key."""
    return b"".join(
        [
            camera.intrinsics_px.tobytes(),
            camera.camera_T_ego.tobytes(),
            f"{camera.width_px}x{camera.height_px}".encode(),
        ]
    )
