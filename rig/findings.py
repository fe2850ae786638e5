"""A finding: one problem of a rig, with its severity, likely cause and remedy."""

import re
from collections.abc import Iterable
from dataclasses import asdict, dataclass, replace
from enum import StrEnum
from typing import Any

from ..runtime.errors import InputError


class Verdict(StrEnum):
    """The severity of a finding, and of a whole examination.

    OK: no problem found.
    NOT_JUDGED: there is too little evidence for a judgement. No finding has this verdict; see `NotJudged`.
    SUSPECT: unusual; a person should check the pictures.
    BROKEN: impossible for a correct calibration or recording.
    """

    OK = "ok"
    NOT_JUDGED = "not judged"
    SUSPECT = "suspect"
    BROKEN = "broken"

    @property
    def severity(self) -> int:
        """0 for ok, larger for more severe verdicts."""
        return list(Verdict).index(self)


@dataclass(frozen=True)
class Finding:
    """One problem of a camera or of the ego motion.

    subject: the checked property, for example "pose".
    expected, got: noun phrases, without a full stop.
    cause, remedy: sentences; may be empty.
    frame: index of the first frame with the problem.
    num_frames: number of checked frames with the problem.
    """

    subject: str
    verdict: Verdict
    expected: str
    got: str
    cause: str
    remedy: str
    frame: int = 0
    num_frames: int = 1

    def __str__(self) -> str:
        return f"{self.subject}: expected {self.expected}; got {self.got}. {self.cause} {self.remedy}".rstrip()

    def to_dict(self) -> dict[str, Any]:
        """The fields, for JSON."""
        return asdict(self)


@dataclass(frozen=True)
class NotJudged:
    """A check that could not be made.

    check: the checked property, for example "direction of motion".
    reason: why it was not judged, as a noun phrase.
    cameras: names of the cameras that it concerns; empty for the whole recording.
    """

    check: str
    reason: str
    cameras: tuple[str, ...] = ()

    def __str__(self) -> str:
        cameras = f" of {', '.join(self.cameras)}" if self.cameras else ""
        return f"{self.check}{cameras}: {self.reason}"

    def to_dict(self) -> dict[str, Any]:
        """The fields, for JSON."""
        return asdict(self)


def finding_from_error(subject: str, error: InputError, cause: str = "", remedy: str = "") -> Finding:
    """Convert the error that the pipeline raises for an input to a finding with the verdict BROKEN.

    error: its message is split if it has the form "PLACE: expected ...; got .... HINT". Otherwise all of it becomes
        `got`.
    cause: if empty, the hint is the cause.
    """
    parts = re.fullmatch(r"(?:.*?: )?expected (.*?); got (.*?)\.(?: ([A-Z].*))?", str(error), re.DOTALL)
    expected, got, hint = parts.groups() if parts else ("a readable file", str(error).rstrip("."), None)
    return Finding(subject, Verdict.BROKEN, expected, got, cause or hint or "The pipeline rejects this input.", remedy)


def worst_verdict(findings: Iterable[Finding]) -> Verdict:
    """The most severe verdict, or OK if there are no findings."""
    return max((finding.verdict for finding in findings), key=lambda verdict: verdict.severity, default=Verdict.OK)


def merge_findings(findings: Iterable[tuple[int, Finding]]) -> list[Finding]:
    """Merge the findings of one camera, or of the ego motion, over many frames. The most severe come first.

    findings: pairs of a frame index and a finding, in order of the frames.

    Returns one finding per subject and verdict: that of the first frame, with the number of frames that have it.
    """
    first: dict[tuple[str, Verdict], Finding] = {}
    frames: dict[tuple[str, Verdict], set[int]] = {}
    for frame, finding in findings:
        key = finding.subject, finding.verdict
        first.setdefault(key, replace(finding, frame=frame))
        frames.setdefault(key, set()).add(frame)
    merged = (replace(finding, num_frames=max(finding.num_frames, len(frames[key]))) for key, finding in first.items())
    return sorted(merged, key=lambda finding: -finding.verdict.severity)
