"""Diagnoses: findings that several cameras share are given once, with the names of the cameras."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from .findings import Finding


class Diagnosis(NamedTuple):
    """A finding and the cameras that have it. Its frame and its numbers are those of one of the cameras."""

    cameras: tuple[str, ...]
    finding: Finding

    def describe_cameras(self, num_cameras: int) -> str:
        """The cameras as text. num_cameras: of the whole rig."""
        if len(self.cameras) == num_cameras > 1:
            return f"all {num_cameras} cameras"
        return f"camera{'s' if len(self.cameras) > 1 else ''} {', '.join(self.cameras)}"


def group_findings(findings: Mapping[str, Sequence[Finding]]) -> list[Diagnosis]:
    """Group the findings by what is expected and by their cause. The most severe of a group stands for it.

    findings: by camera.
    """
    groups: dict[tuple[str, str, str], dict[str, Finding]] = {}
    for name, each in findings.items():
        for finding in each:
            groups.setdefault((finding.subject, finding.expected, finding.cause), {}).setdefault(name, finding)
    diagnoses = [
        Diagnosis(tuple(group), max(group.values(), key=lambda finding: finding.verdict.severity))
        for group in groups.values()
    ]
    return sorted(diagnoses, key=lambda diagnosis: -diagnosis.finding.verdict.severity)
