"""What is found wrong with a rig, in words, and how bad it is."""

import re
from collections.abc import Iterable
from dataclasses import asdict, dataclass, replace
from enum import StrEnum
from typing import Any

from ..runtime.errors import InputError


class Verdict(StrEnum):
    """From good to bad: fine; what cannot be known, a person should look at the picture; what cannot be right."""

    OK = "ok"
    SUSPECT = "suspect"
    BROKEN = "broken"

    @property
    def rank(self) -> int:
        """The larger the worse."""
        return list(Verdict).index(self)


@dataclass(frozen=True)
class Finding:
    """One thing that is wrong: what was looked at, how bad it is, and four answers in words.

    frame: the first frame that has it; num_frames: how many of the frames that were looked at have it.
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
        return f"{self.subject}: expected {self.expected}; got {self.got}. {self.cause} {self.remedy}"

    def to_dict(self) -> dict[str, Any]:
        """The fields, for JSON."""
        return asdict(self)


def refusal(subject: str, error: InputError, cause: str = "", remedy: str = "") -> Finding:
    """A broken thing, in the words with which the pipeline refuses it: WHAT: expected ...; got .... HINT"""
    words = re.fullmatch(r"(?:.*?: )?expected (.*?); got (.*?)\.(?: ([A-Z].*))?", str(error), re.DOTALL)
    expected, got, hint = words.groups() if words else ("something that can be read", str(error).rstrip("."), None)
    return Finding(subject, Verdict.BROKEN, expected, got, cause or hint or "The pipeline refuses it.", remedy)


def worst(findings: Iterable[Finding]) -> Verdict:
    """The verdict of the worst finding, or ok for none."""
    return max((finding.verdict for finding in findings), key=lambda verdict: verdict.rank, default=Verdict.OK)


def merge(findings: Iterable[tuple[int, Finding]]) -> list[Finding]:
    """Findings by frame, each subject once a verdict: as the first frame words it, and in how many frames it is."""
    first: dict[tuple[str, Verdict], Finding] = {}
    indices: dict[tuple[str, Verdict], set[int]] = {}
    for index, finding in findings:
        key = finding.subject, finding.verdict
        first.setdefault(key, replace(finding, frame=index))
        indices.setdefault(key, set()).add(index)
    merged = (replace(finding, num_frames=len(indices[key])) for key, finding in first.items())
    return sorted(merged, key=lambda finding: -finding.verdict.rank)
