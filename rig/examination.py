"""The examination of a rig: every calibration, time and pose of a recording, and the pictures of some of its frames."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import combinations
from typing import NamedTuple

from ..runtime.frame import Camera, Frame
from ..runtime.progress import Progress, no_progress
from .calibration import Calibration, photo_findings
from .camera_pairs import exchange_findings, name_findings, picture_findings, twin_findings
from .coverage import Coverage, Sector, blind_sectors, cover
from .findings import Finding, Verdict, merge, worst
from .motion import Step, moment_findings, step_findings, steps_of
from .recording import CameraImage, Recording, spread
from .requirements import RigRequirements

Found = list[tuple[int, Finding]]  # with the frame that each is of
Calibrations = Mapping[str, Calibration]  # of one frame, by camera


class Sizes(NamedTuple):
    """Width and height of a camera's picture in one frame: of its file, None where there is none, and as calibrated."""

    image_px: tuple[int, int] | None
    calibration_px: tuple[int, int]


@dataclass(frozen=True)
class CameraView:
    """A camera as it is shown: its calibration in one frame, and its picture there.

    The frame is the first one of its worst calibration, if possible with a picture. findings: of all frames.
    num_calibrations: how many distinct ones the recording has. is_sound: whether this one, by itself, is not broken;
    what is wrong with a picture or a neighbour is another matter.
    """

    frame: int
    camera: Camera
    photo: CameraImage
    findings: tuple[Finding, ...]
    num_calibrations: int
    is_sound: bool

    @property
    def verdict(self) -> Verdict:
        return worst(self.findings)


@dataclass(frozen=True)
class Examination:
    """What was found out about a rig.

    sizes: by frame that was looked at, by camera.
    coverage and blind_sectors: of the cameras whose calibration is not broken, each as its view has it.
    """

    requirements: RigRequirements
    num_frames: int
    views: Mapping[str, CameraView]
    sizes: Mapping[int, Mapping[str, Sizes]]
    motion_findings: tuple[Finding, ...]
    steps: tuple[Step, ...]
    coverage: Coverage
    blind_sectors: tuple[Sector, ...]

    @property
    def motion_verdict(self) -> Verdict:
        return worst(self.motion_findings)

    @property
    def verdict(self) -> Verdict:
        return worst([*self.motion_findings, *(finding for view in self.views.values() for finding in view.findings)])


def examine(
    recording: Recording, requirements: RigRequirements, num_frames: int, progress: Progress = no_progress
) -> Examination:
    """Look at all that a recording says, and at the pictures of `num_frames` of its frames, spread over it.

    Frames in which a calibration is at its worst are looked at beside those. progress: passes frames on, for progress.
    """
    frames, calibrations, found = _read(recording, progress)
    shown = {name: _worst_frames(calibrations, name, found[name]) for name in found}
    looked_at = sorted({*spread(len(frames), num_frames), *(indices[0] for indices in shown.values())})
    camera_images: dict[str, tuple[int, CameraImage]] = {}
    sizes: dict[int, dict[str, Sizes]] = {}
    for index in progress(looked_at, "pictures"):
        seen = recording.camera_images(index)
        sizes[index] = {
            name: Sizes(seen.get(name, CameraImage()).size_px, (camera.width_px, camera.height_px))
            for name, camera in frames[index].cameras.items()
        }
        for name, finding in _photo_findings(frames[index], seen):
            found[name].append((index, finding))
        for name, photo in seen.items():
            if index in shown[name] and (name not in camera_images or camera_images[name][1].image is None):
                camera_images[name] = index, photo
    views = {
        name: _view(calibrations, name, camera_images.get(name, (shown[name][0], CameraImage())), found[name])
        for name in found
    }
    return _examination(requirements, frames, _with_unseen(views, sizes), sizes)


def _read(recording: Recording, progress: Progress) -> tuple[list[Frame], list[Calibrations], dict[str, Found]]:
    """All frames, their calibrations, and what is wrong with those by camera: each distinct one is looked at once."""
    frames: list[Frame] = []
    calibrations: list[Calibrations] = []
    found: dict[str, Found] = {}
    known: dict[tuple[str, bytes], Calibration] = {}
    known_pairs: dict[tuple[Calibration, Calibration], list[tuple[str, Finding]]] = {}
    for index in progress(range(len(recording)), "calibrations"):
        frame = recording.frame_without_images(index)
        seen = _calibrations(frame, known)
        for name in seen:
            found.setdefault(name, [])
        for name, finding in (*_own_findings(seen), *_pair_findings(seen, known_pairs)):
            found[name].append((index, finding))
        frames.append(frame)
        calibrations.append(seen)
    return frames, calibrations, found


def _calibrations(frame: Frame, known: dict[tuple[str, bytes], Calibration]) -> Calibrations:
    """The calibrations of a frame; known: those of the frames before, by what they say."""
    keys = {name: (name, _bytes(camera)) for name, camera in frame.cameras.items()}
    for name, key in keys.items():
        if key not in known:
            known[key] = Calibration.of(name, frame.cameras[name])
    return {name: known[key] for name, key in keys.items()}


def _own_findings(seen: Calibrations) -> Iterator[tuple[str, Finding]]:
    """What is wrong with each calibration of a frame by itself, and beside the camera's name."""
    for name, calibration in seen.items():
        for finding in (*calibration.findings, *name_findings(calibration)):
            yield name, finding


def _pair_findings(
    seen: Calibrations, known: dict[tuple[Calibration, Calibration], list[tuple[str, Finding]]]
) -> Iterator[tuple[str, Finding]]:
    """What is wrong between the cameras of a frame; known: what was found between those of the frames before."""
    for pair in combinations((calibration for calibration in seen.values() if calibration.is_sound), 2):
        if pair not in known:
            known[pair] = [*twin_findings(*pair), *exchange_findings(*pair)]
        yield from known[pair]


def _worst_frames(calibrations: list[Calibrations], name: str, found: Found) -> list[int]:
    """The frames in which a camera's calibration is at its worst."""
    findings: dict[int, list[Finding]] = {index: [] for index, seen in enumerate(calibrations) if name in seen}
    for index, finding in found:
        findings[index].append(finding)
    ranks = {index: worst(each).rank for index, each in findings.items()}
    return [index for index, rank in ranks.items() if rank == max(ranks.values())]


def _photo_findings(frame: Frame, camera_images: Mapping[str, CameraImage]) -> Iterable[tuple[str, Finding]]:
    for name, photo in camera_images.items():
        for finding in photo_findings(photo, frame.cameras[name]):
            yield name, finding
    yield from picture_findings(camera_images)


def _view(calibrations: list[Calibrations], name: str, shown: tuple[int, CameraImage], found: Found) -> CameraView:
    index, photo = shown
    distinct = {seen[name] for seen in calibrations if name in seen}
    calibration = calibrations[index][name]
    return CameraView(index, calibration.camera, photo, tuple(merge(found)), len(distinct), calibration.is_sound)


def _with_unseen(views: dict[str, CameraView], sizes: Mapping[int, Mapping[str, Sizes]]) -> dict[str, CameraView]:
    """The views, with a doubt about those cameras that were lost whenever they were looked at."""
    for name, view in views.items():
        is_seen = any(name in frame and frame[name].image_px for frame in sizes.values())
        if not is_seen and not any(finding.subject == "picture" for finding in view.findings):
            got = f"none in the {len(sizes)} frames that were looked at"
            cause, remedy = (
                "The camera is lost throughout, or its paths are missing.",
                "Give its paths, or leave it out.",
            )
            views[name] = _with(
                view, Finding("picture", Verdict.SUSPECT, "a picture in some frame", got, cause, remedy)
            )
    return views


def _examination(
    requirements: RigRequirements,
    frames: list[Frame],
    views: dict[str, CameraView],
    sizes: Mapping[int, Mapping[str, Sizes]],
) -> Examination:
    grid = requirements.perception, requirements.preprocessing
    steps = steps_of(frames, requirements)
    coverage = cover({name: view.camera for name, view in views.items() if view.is_sound}, *grid)
    for name in coverage.voxels:
        if not coverage.voxels[name].any():
            views[name] = _with(views[name], _blind(name))
    return Examination(
        requirements=requirements,
        num_frames=len(frames),
        views=views,
        sizes=sizes,
        motion_findings=(*moment_findings(frames, requirements), *step_findings(steps, requirements)),
        steps=tuple(steps),
        coverage=coverage,
        blind_sectors=tuple(blind_sectors({name: views[name].camera for name in coverage.voxels}, *grid)),
    )


def _blind(name: str) -> Finding:
    return Finding(
        "coverage",
        Verdict.SUSPECT,
        "some of the voxels before the camera",
        f"none that {name} sees",
        "It looks away from the road, or what it sees of it is cut off.",
        "Correct the calibration, or leave the camera out.",
    )


def _with(view: CameraView, finding: Finding) -> CameraView:
    findings = sorted((*view.findings, replace(finding, frame=view.frame)), key=lambda each: -each.verdict.rank)
    return replace(view, findings=tuple(findings))


def _bytes(camera: Camera) -> bytes:
    return b"".join(
        [
            camera.intrinsics_px.tobytes(),
            camera.camera_T_ego.tobytes(),
            f"{camera.width_px}x{camera.height_px}".encode(),
        ]
    )
