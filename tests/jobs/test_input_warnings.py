"""Warnings about input: each finding once, with all cameras that share it."""

from duospacenet.jobs.input_warnings import DRIVE, InputWarnings, describe_findings
from duospacenet.rig import Finding, Verdict


def finding(subject: str = "pose", cause: str = "Likely cause: inches.", **changes) -> Finding:
    fields = {"subject": subject, "verdict": Verdict.SUSPECT, "expected": "one", "got": "another", "cause": cause}
    return Finding(**fields | {"remedy": "Correct it.", "frame": 3} | changes)


def test_a_finding_is_reported_once_and_again_only_if_it_becomes_worse():
    messages: list[str] = []
    warnings = InputWarnings(messages.append)
    for _ in range(3):
        warnings.add([("FRONT", finding())])
    assert messages == [
        "warning: frame 3, camera FRONT: pose: expected one; got another. Likely cause: inches. Correct it."
    ]
    warnings.add([("FRONT", finding(got="a third", frame=5))])
    assert len(messages) == 1
    warnings.add([("FRONT", finding(verdict=Verdict.BROKEN)), ("BACK", finding(got="a third"))])
    assert len(messages) == 2
    assert warnings.texts == [message.removeprefix("warning: ") for message in messages]


def test_cameras_with_the_same_cause_are_reported_together():
    warnings = InputWarnings()
    warnings.add([("FRONT", finding()), ("BACK", finding(got="a third")), ("LEFT", finding(cause="Something else."))])
    assert [text.partition(": pose")[0] for text in warnings.texts] == [
        "frame 3, cameras FRONT, BACK",
        "frame 3, camera LEFT",
    ]


def test_findings_of_several_sources_are_told_apart():
    warnings = InputWarnings()
    for source in ("one", "other", "one"):
        warnings.add([(DRIVE, finding("history"))], source)
    assert [text.partition(": history")[0] for text in warnings.texts] == [
        "one: frame 3, drive",
        "other: frame 3, drive",
    ]


def test_the_numbers_of_a_description_are_those_of_the_first_camera():
    assert describe_findings([("LEFT", finding(got="two")), ("BACK", finding())]) == (
        "cameras LEFT, BACK: pose: expected one; got two. Likely cause: inches. Correct it."
    )
