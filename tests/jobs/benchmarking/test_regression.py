"""The comparison of two reports that were written by hand."""

import json
from pathlib import Path

import pytest

from duospacenet.jobs.benchmarking.regression import Baseline, check_baseline, compare_reports, read_baseline
from duospacenet.jobs.benchmarking.targets import Target
from duospacenet.runtime.errors import InputError, UsageError
from tests.helpers.bench_reports import report, report_values

TARGET = Target(name="bundle", kind="bundle", bundle=Path("bundle"), threads=2)


def changes_of(old, new, max_regression=0.1):
    comparison = compare_reports(Baseline(Path("old.json"), old), new, max_regression)
    return comparison, {change.figure: change.slowdown for change in comparison.changes}


def test_ratios_are_compared_if_both_reports_have_the_alternative():
    comparison, changes = changes_of(report({"eager": 8.0}, 100.0), report({"eager": 7.5, "stateless": 5.0}, 900.0))
    assert changes == {"eager / bundle": pytest.approx(8.0 / 7.5 - 1, abs=1e-4)}
    assert comparison.passed


def test_a_smaller_ratio_than_permitted_is_a_regression():
    comparison, changes = changes_of(report({"eager": 8.0}), report({"eager": 7.0}))
    assert changes["eager / bundle"] == pytest.approx(1 / 7, abs=1e-4)
    assert not comparison.passed
    assert changes_of(report({"eager": 8.0}), report({"eager": 7.0}), max_regression=0.2)[0].passed


def test_milliseconds_are_compared_without_a_common_alternative():
    """The stages that take less than a twentieth of the frame are left out."""
    comparison, changes = changes_of(report({"eager": 8.0}, 100.0), report({}, 105.0))
    assert changes == {
        "frame, median ms": 0.05,
        "backbone, median ms": 0.0,
        "lifter, median ms": 0.0,
        "decoder, median ms": 0.0,
        "2 streams, frames/s": 0.0,
    }
    assert comparison.passed


def test_a_slower_frame_than_permitted_is_a_regression():
    comparison, _ = changes_of(report(frame_ms=100.0), report(frame_ms=111.0))
    assert [change.figure for change in comparison.regressions] == ["frame, median ms"]
    assert not comparison.passed


def test_a_faster_bundle_is_no_regression():
    assert changes_of(report(frame_ms=100.0), report(frame_ms=50.0), max_regression=0.0)[0].passed


def test_bundles_of_the_same_name_are_not_compared():
    _, changes = changes_of(report({"out/other": 2.0}), report({"out/other": 1.0}))
    assert "out/other / bundle" not in changes


def write(path: Path, values) -> Path:
    path.write_text(json.dumps(values))
    return path


def test_a_report_is_read_from_the_output_of_the_command(tmp_path):
    values = report_values({"eager": 8.0}) | {"comparison": {"passed": True}}
    assert read_baseline(write(tmp_path / "old.json", values)).report == report({"eager": 8.0})


@pytest.mark.parametrize(
    "values, words",
    [
        ({"passed": True, "graphs": {}}, "expected a report of `duospacenet bench --json`"),
        (report_values() | {"schema_version": 2}, "schema 1"),
        (report_values() | {"rounds": 0}, "field rounds"),
        (report_values() | {"surprise": 1}, "field surprise"),
    ],
)
def test_another_json_file_is_refused(tmp_path, values, words):
    with pytest.raises(InputError, match=words):
        read_baseline(write(tmp_path / "old.json", values))


def test_a_file_that_is_not_json_is_refused(tmp_path):
    (tmp_path / "old.json").write_text("p50 12 ms")
    with pytest.raises(InputError, match=r"old\.json"):
        read_baseline(tmp_path / "old.json")


def of_another_machine(ratios=None) -> Baseline:
    values = report_values(ratios)
    values["machine"]["cpu"] = "Another CPU"
    return Baseline(Path("old.json"), report().model_validate(values))


def test_milliseconds_of_another_cpu_are_refused_before_the_measurement(pipeline):
    with pytest.raises(UsageError, match=r"another machine .*Another CPU.* ratios can: add --against .*eager"):
        check_baseline(of_another_machine({"eager": 8.0}), pipeline.manifest, TARGET, [])


def test_ratios_of_another_cpu_can_be_compared_with_a_note(pipeline):
    notes = []
    check_baseline(of_another_machine({"eager": 8.0}), pipeline.manifest, TARGET, ["eager"], notes.append)
    assert len(notes) == 1
    assert "Another CPU" in notes[0] and notes[0].endswith("only ratios are compared")


def test_milliseconds_with_another_number_of_threads_are_refused(pipeline):
    four_threads = TARGET.model_copy(update={"threads": 4})
    check_baseline(Baseline(Path("old.json"), report()), pipeline.manifest, TARGET, [])
    with pytest.raises(UsageError, match=r"2 threads; this one is .*4 threads"):
        check_baseline(Baseline(Path("old.json"), report()), pipeline.manifest, four_threads, [])


def test_the_report_of_another_preset_is_refused(pipeline):
    values = report_values()
    values["bundle"]["preset"] = "nano"
    with pytest.raises(UsageError, match=r"expected a report of preset 'tiny'; old\.json is of 'nano'"):
        check_baseline(Baseline(Path("old.json"), report().model_validate(values)), pipeline.manifest, TARGET, [])
