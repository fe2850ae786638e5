"""The examination of a rig: every calibration, time and pose of a recording, and the pictures of some of its frames."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple

from ..frame import Camera, Frame
from .calibration import calibration_findings, photo_findings
from .coverage import Coverage, Sector, blind_sectors, cover
from .demands import Demands
from .drive import Step, moment_findings, step_findings, steps_of
from .findings import Finding, Verdict, merge, worst
from .neighbours import name_findings, picture_findings, twin_findings
from .recording import Photo, Recording, spread

Track = Callable[[Iterable[int], str], Iterable[int]]
Found = list[tuple[int, Finding]]  # with the frame that each is of


class Sizes(NamedTuple):
    """Width and height of a camera's picture in one frame: of its file, None where there is none, and as calibrated."""

    image_px: tuple[int, int] | None
    calibration_px: tuple[int, int]


@dataclass(frozen=True)
class CameraView:
    """A camera as it is shown: its calibration in one frame, and its picture there.

    The frame is the first one of its worst calibration, if possible with a picture. findings: of all frames.
    num_calibrations: how many distinct ones the recording has.
    """

    frame: int
    camera: Camera
    photo: Photo
    findings: tuple[Finding, ...]
    num_calibrations: int

    @property
    def verdict(self) -> Verdict:
        return worst(self.findings)


@dataclass(frozen=True)
class Examination:
    """What was found out about a rig.

    sizes: by frame that was looked at, by camera.
    coverage and blind_sectors: of the cameras whose calibration is not broken, each as its view has it.
    """

    demands: Demands
    num_frames: int
    views: Mapping[str, CameraView]
    sizes: Mapping[int, Mapping[str, Sizes]]
    drive_findings: tuple[Finding, ...]
    steps: tuple[Step, ...]
    coverage: Coverage
    blind_sectors: tuple[Sector, ...]

    @property
    def drive_verdict(self) -> Verdict:
        return worst(self.drive_findings)

    @property
    def verdict(self) -> Verdict:
        return worst([*self.drive_findings, *(finding for view in self.views.values() for finding in view.findings)])


def examine(
    recording: Recording, demands: Demands, num_frames: int, track: Track = lambda items, _: items
) -> Examination:
    """Look at all that a recording says, and at the pictures of `num_frames` of its frames, spread over it.

    Frames in which a calibration is at its worst are looked at beside those. track: passes frames on, for progress.
    """
    frames = [recording.blind_frame(index) for index in track(range(len(recording)), "calibrations")]
    found = _calibration_findings(frames)
    shown = {name: _worst_frames(frames, name, found[name]) for name in found}
    looked_at = sorted({*spread(len(frames), num_frames), *(indices[0] for indices in shown.values())})
    photos: dict[str, tuple[int, Photo]] = {}
    sizes: dict[int, dict[str, Sizes]] = {}
    for index in track(looked_at, "pictures"):
        seen = recording.photos(index)
        sizes[index] = {
            name: Sizes(seen.get(name, Photo()).size_px, (camera.width_px, camera.height_px))
            for name, camera in frames[index].cameras.items()
        }
        for name, finding in _photo_findings(frames[index], seen):
            found[name].append((index, finding))
        for name, photo in seen.items():
            if index in shown[name] and (name not in photos or photos[name][1].image is None):
                photos[name] = index, photo
    views = {name: _view(frames, name, photos.get(name, (shown[name][0], Photo())), found[name]) for name in found}
    views = _with_unseen(_with_twins(views), sizes)
    return _examination(demands, frames, views, sizes)


def _calibration_findings(frames: list[Frame]) -> dict[str, Found]:
    """What is wrong with each camera's numbers, by camera: each distinct calibration is looked at once."""
    known: dict[tuple[str, bytes], list[Finding]] = {}
    found: dict[str, Found] = {}
    for index, frame in enumerate(frames):
        for name, camera in frame.cameras.items():
            key = name, _bytes(camera)
            if key not in known:
                known[key] = _own_findings(name, camera)
            found.setdefault(name, []).extend((index, finding) for finding in known[key])
    return found


def _own_findings(name: str, camera: Camera) -> list[Finding]:
    """What is wrong with a calibration; a name is held against a pose only where the pose by itself can be."""
    findings = calibration_findings(name, camera)
    is_doubted = worst(findings) is Verdict.BROKEN or any(finding.subject == "pose" for finding in findings)
    return findings if is_doubted else [*findings, *name_findings(name, camera)]


def _worst_frames(frames: list[Frame], name: str, found: Found) -> list[int]:
    """The frames in which a camera's calibration is at its worst."""
    verdicts = {index: Verdict.OK for index, frame in enumerate(frames) if name in frame.cameras}
    for index, finding in found:
        verdicts[index] = worst_of(verdicts[index], finding.verdict)
    highest = max(verdict.rank for verdict in verdicts.values())
    return [index for index, verdict in verdicts.items() if verdict.rank == highest]


def worst_of(one: Verdict, other: Verdict) -> Verdict:
    """The worse of two verdicts."""
    return one if one.rank >= other.rank else other


def _photo_findings(frame: Frame, photos: Mapping[str, Photo]) -> Iterable[tuple[str, Finding]]:
    for name, photo in photos.items():
        for finding in photo_findings(photo, frame.cameras[name]):
            yield name, finding
    yield from picture_findings(photos)


def _view(frames: list[Frame], name: str, shown: tuple[int, Photo], found: Found) -> CameraView:
    index, photo = shown
    distinct = {_bytes(frame.cameras[name]) for frame in frames if name in frame.cameras}
    return CameraView(index, frames[index].cameras[name], photo, tuple(merge(found)), len(distinct))


def _with_twins(views: dict[str, CameraView]) -> dict[str, CameraView]:
    """The views with what is wrong between them."""
    for name, finding in twin_findings({name: view.camera for name, view in sound(views).items()}):
        views[name] = _with(views[name], finding)
    return views


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
    demands: Demands,
    frames: list[Frame],
    views: dict[str, CameraView],
    sizes: Mapping[int, Mapping[str, Sizes]],
) -> Examination:
    grid = demands.perception, demands.preprocessing
    steps = steps_of(frames, demands)
    coverage = cover({name: view.camera for name, view in sound(views).items()}, *grid)
    for name in coverage.voxels:
        if not coverage.voxels[name].any():
            views[name] = _with(views[name], _blind(name))
    return Examination(
        demands=demands,
        num_frames=len(frames),
        views=views,
        sizes=sizes,
        drive_findings=(*moment_findings(frames, demands), *step_findings(steps, demands)),
        steps=tuple(steps),
        coverage=coverage,
        blind_sectors=tuple(blind_sectors({name: views[name].camera for name in coverage.voxels}, *grid)),
    )


def sound(views: Mapping[str, CameraView]) -> dict[str, CameraView]:
    """The views whose own calibration is not broken; what is wrong with a picture or a neighbour is another matter."""
    return {
        name: view
        for name, view in views.items()
        if worst(calibration_findings(name, view.camera)) is not Verdict.BROKEN
    }


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
