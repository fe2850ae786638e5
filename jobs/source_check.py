"""The check of a whole source before its first frame is processed: everything except the pixels of the images.

An input that a bundle cannot process is refused here, before hours of work and before any earlier result is replaced.
"""

import hashlib
from collections import Counter
from collections.abc import Mapping
from dataclasses import replace

from ..data.source import Source
from ..rig import Finding, RigRequirements, Verdict, judge_calibration
from ..rig.calibration import calibration_bytes
from ..rig.history_resets import HistoryResets
from ..rig.motion import step_findings, steps_between
from ..runtime.bundle.manifest import Manifest
from ..runtime.errors import InputError
from ..runtime.frame import Camera, Frame
from ..runtime.history import find_reset
from ..runtime.lost_cameras import MissingCameraPolicy
from ..runtime.progress import Progress, no_progress
from ..runtime.validation import check_frame, check_frame_header
from .input_warnings import DRIVE, InputWarnings, describe_findings

LONG_SOURCE = 1000  # frames; the check of fewer takes about a second

CameraFinding = tuple[str, Finding]


def check_source(
    source: Source,
    manifest: Manifest,
    warnings: InputWarnings,
    *,
    name: str = "",
    on_missing: MissingCameraPolicy = "blank",
    num_frames: int | None = None,
    refuse_broken: bool = True,
    progress: Progress = no_progress,
) -> None:
    """Check calibrations, times and poses of all frames, and the headers of their image files.

    warnings: gets the findings that do not prevent the run.
    name: of the source, for warnings of jobs with several sources.
    num_frames: check only the first frames.
    refuse_broken: refuse calibrations that `check-rig` calls broken; otherwise warn about them.
    progress: only used for long sources.
    Raises InputError, naming the frame and the camera.
    """
    requirements = RigRequirements.from_manifest(manifest)
    calibrations, resets, images = _CalibrationCheck(refuse_broken), HistoryResets(requirements), _LostImages()
    headers: list[Frame] = []
    indices = range(len(source))[:num_frames]
    for index in progress(indices, "check") if len(indices) > LONG_SOURCE else indices:
        frame = source.frame_without_images(index)
        try:
            check_frame_header(frame, manifest.num_cameras)
            if headers:
                find_reset(headers[-1], frame, requirements)  # raises for a time that is not later
            warnings.add(calibrations.add(index, frame), name)
            lost = source.check_image_files(index)
            _check_lost_cameras(lost, on_missing)
            images.add(index, len(frame.cameras), lost)
        except InputError as error:
            raise InputError(f"frame {index}: {error}") from None
        header = _without_calibration(frame, headers)
        headers.append(header)
        resets.add(index, header)
    steps = steps_between(headers, requirements)
    motion = step_findings(steps, requirements, float(headers[0].timestamp_s))
    # The findings about times and poses name the cause of the resets more exactly.
    dropped = [replace(each, cause="", remedy="") if motion else each for each in resets.drive_findings()]
    warnings.add([(DRIVE, finding) for finding in (*motion, *dropped, *images.findings())], name)


class _CalibrationCheck:
    """Checks and judges each distinct set of calibrations once. Keeps a hash of each set."""

    def __init__(self, refuse_broken: bool) -> None:
        self._refuse_broken = refuse_broken
        self._judged: set[bytes] = set()

    def add(self, index: int, frame: Frame) -> list[CameraFinding]:
        """Return the findings about the calibrations of a frame. Raises InputError for invalid and broken ones."""
        key = _hash_calibration(frame.cameras)
        if key in self._judged:
            return []
        check_frame(frame, num_cameras=len(frame.cameras))
        self._judged.add(key)
        judged = judge_calibration(frame.cameras)
        findings = [(name, replace(finding, frame=index)) for name, each in judged.findings.items() for finding in each]
        if judged.verdict is Verdict.BROKEN and self._refuse_broken:
            raise InputError(_describe_broken(findings))
        return findings


class _LostImages:
    """Counts the images that a source does not have, by camera."""

    def __init__(self) -> None:
        self._lost: Counter[str] = Counter()
        self._num_images = 0
        self._frames: list[int] = []

    def add(self, index: int, num_cameras: int, lost: tuple[str, ...]) -> None:
        """Add the next frame. lost: the names of its lost cameras."""
        self._num_images += num_cameras
        self._lost.update(lost)
        if lost:
            self._frames.append(index)

    def findings(self) -> list[Finding]:
        """Return one finding with the numbers, if any image is lost."""
        if not self._frames:
            return []
        by_camera = ", ".join(f"{name}: {count}" for name, count in sorted(self._lost.items()))
        return [
            Finding(
                "images",
                Verdict.SUSPECT,
                "an image of every camera",
                f"{self._lost.total()} of {self._num_images} images lost ({by_camera})",
                "Their files are missing, or the source names no file for them.",
                "",
                self._frames[0],
                len(self._frames),
            )
        ]


def _describe_broken(findings: list[CameraFinding]) -> str:
    """The first diagnosis of a broken calibration with all its cameras, the number of others, and what to do."""
    broken = [finding for _, finding in findings if finding.verdict is Verdict.BROKEN]
    diagnosis = broken[0].subject, broken[0].cause
    group = [item for item in findings if (item[1].subject, item[1].cause) == diagnosis]
    group.sort(key=lambda item: item[1].verdict is not Verdict.BROKEN)  # its numbers are those of a broken camera
    others = {(finding.subject, finding.cause) for finding in broken} - {diagnosis}
    more = f" And {len(others)} more." if others else ""
    return (
        f"{describe_findings(group)}{more} `duospacenet check-rig` shows pictures and all numbers. Add --no-check if "
        "the calibration is right nevertheless."
    )


def _check_lost_cameras(lost: tuple[str, ...], on_missing: MissingCameraPolicy) -> None:
    if lost and on_missing == "error":
        raise InputError(
            f"camera {lost[0]}: expected an image, because of --on-missing error; got a lost camera. Leave the frame "
            "out, or choose --on-missing blank or skip."
        )


def _without_calibration(frame: Frame, headers: list[Frame]) -> Frame:
    """The frame's time, pose and scene. All headers share the calibration of the first, to save memory."""
    cameras = headers[0].cameras if headers else frame.cameras
    return replace(frame, images={}, cameras=cameras, ground_truth=None)


def _hash_calibration(cameras: Mapping[str, Camera]) -> bytes:
    digest = hashlib.blake2b(digest_size=16)
    for name, camera in cameras.items():
        digest.update(repr(name).encode(errors="surrogatepass"))
        digest.update(calibration_bytes(camera))
    return digest.digest()
