"""Findings: made from errors, merged over frames."""

from duospacenet.rig.findings import Finding, Verdict, finding_from_error, merge_findings, worst_verdict
from duospacenet.runtime.errors import InputError


def test_a_finding_from_an_error_keeps_the_expected_and_the_actual_value():
    finding = finding_from_error(
        "pose", InputError("camera A: x: expected 1.5 m; got [2.5, 0]. Turn it. Then try."), remedy="Do."
    )
    assert (finding.expected, finding.got, finding.cause) == ("1.5 m", "[2.5, 0]", "Turn it. Then try.")
    assert str(finding_from_error("file", InputError("a.png: cannot be read (Input/output error)."))).startswith(
        "file: expected a readable file; got a.png: cannot be read (Input/output error). "
    )


def test_findings_of_many_frames_are_merged_with_the_worst_first():
    suspect, broken = (Finding("pose", verdict, "", "", "", "") for verdict in (Verdict.SUSPECT, Verdict.BROKEN))
    merged = merge_findings([(3, suspect), (4, suspect), (4, suspect), (7, broken)])
    assert [(each.verdict, each.frame, each.num_frames) for each in merged] == [("broken", 7, 1), ("suspect", 3, 2)]
    assert worst_verdict(merged) is Verdict.BROKEN
    assert worst_verdict([]) is Verdict.OK
