"""Findings with the same cause become one diagnosis with the names of the cameras."""

from dataclasses import replace

from duospacenet.rig import Finding, Verdict
from duospacenet.rig.diagnoses import group_findings

INVERTED = Finding("pose", Verdict.SUSPECT, "a usual pose", "z 0.1 m", "It is inverted.", "Correct it.")
LOST = Finding("image", Verdict.SUSPECT, "an image", "none", "It is lost.", "Add it.")


def test_a_shared_cause_is_one_diagnosis_with_the_most_severe_finding():
    broken = replace(INVERTED, verdict=Verdict.BROKEN, got="z -1 m")
    shared, single = group_findings({"a": [INVERTED], "b": [broken, LOST], "c": [INVERTED]})
    assert (shared.cameras, shared.finding) == (("a", "b", "c"), broken)
    assert (single.cameras, single.finding) == (("b",), LOST)
    assert shared.describe_cameras(3) == "all 3 cameras"
    assert shared.describe_cameras(4) == "cameras a, b, c"
    assert single.describe_cameras(3) == "camera b"


def test_no_findings_give_no_diagnosis():
    assert group_findings({"a": [], "b": []}) == []
