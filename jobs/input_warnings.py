"""Warnings about the input of a job: the findings of the rig checks, each reported once."""

from collections.abc import Iterable

from ..rig import Finding, Verdict
from ..rig.stale_input import StaleInput
from ..runtime.frame import Frame
from ..runtime.history import ResetLimits
from .notify import Notify, ignore

DRIVE = ""  # in place of a camera's name: a finding about times, poses or all cameras


class InputWarnings:
    """Reports each finding once. texts: the warnings so far, without "warning: "."""

    def __init__(self, notify: Notify = ignore) -> None:
        self.texts: list[str] = []
        self._notify = notify
        self._reported: set[tuple[str, str, Verdict]] = set()

    def add(self, findings: Iterable[tuple[str, Finding]], source: str = "") -> None:
        """Report the findings that have not been reported, those with the same cause for several cameras together.

        findings: with the camera's name, or DRIVE.
        source: name of the source, if the job has several.
        """
        new: dict[tuple[str, str], list[tuple[str, Finding]]] = {}
        for camera, finding in findings:
            key = f"{source} {camera}", finding.subject, finding.verdict
            if key not in self._reported:
                self._reported.add(key)
                new.setdefault((finding.subject, finding.cause), []).append((camera, finding))
        for group in new.values():
            text = f"frame {group[0][1].frame}, {describe_findings(group)}"
            self.texts.append(f"{source}: {text}" if source else text)
            self._notify(f"warning: {self.texts[-1]}")


class InputWatch:
    """Warns about stale input while the frames of one source pass by, in order."""

    def __init__(self, limits: ResetLimits, warnings: InputWarnings, source: str = "") -> None:
        """source: name of the source, if the job has several."""
        self._stale, self._warnings, self._source = StaleInput(limits), warnings, source

    def add(self, index: int, frame: Frame) -> None:
        """Check the next frame, which is valid."""
        self._stale.add(index, frame)
        self._report(is_complete=False)

    def complete(self) -> None:
        """Report the findings that need all frames."""
        self._report(is_complete=True)

    def _report(self, is_complete: bool) -> None:
        drive_findings = [(DRIVE, finding) for finding in self._stale.drive_findings(is_complete)]
        self._warnings.add([*self._stale.camera_findings(), *drive_findings], self._source)


def describe_findings(findings: list[tuple[str, Finding]]) -> str:
    """Describe findings with the same subject and cause: all cameras, and the numbers of the first one."""
    names = [camera for camera, _ in findings]
    place = "drive" if names == [DRIVE] else f"camera{'s' * (len(names) > 1)} {', '.join(names)}"
    return f"{place}: {findings[0][1]}"
