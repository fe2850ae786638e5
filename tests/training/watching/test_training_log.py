"""Tests of the training log: steps, validations, and the lines that an interruption leaves."""

import json

import pytest

from duospacenet.runtime.errors import ArtifactError, OutputError
from duospacenet.training.watching.training_log import TrainingLog


@pytest.fixture
def log(tmp_path):
    """The log of six steps with a validation after the second, fourth and sixth."""
    log = TrainingLog(tmp_path / "log.jsonl")
    for step in range(6):
        log.append([{"step": step, "total": 6.0 - step}])
        if step % 2:
            log.append([{"step": step + 1, "validation": {"NDS": step / 10}}])
    return log


def test_steps_and_validations_are_read_separately(log):
    assert [line["step"] for line in log.steps()] == [0, 1, 2, 3, 4, 5]
    assert log.validations() == [{"step": step, "validation": {"NDS": (step - 1) / 10}} for step in (2, 4, 6)]


@pytest.mark.parametrize(("step", "steps", "validations"), [(0, 0, 0), (3, 3, 1), (4, 4, 2), (6, 6, 3), (9, 6, 3)])
def test_a_cut_keeps_the_validation_after_its_last_step(log, step, steps, validations):
    log.cut(step)
    assert (len(log.steps()), len(log.validations())) == (steps, validations)


def test_an_incomplete_last_line_is_ignored_and_removed_by_a_cut(log):
    whole = log.path.read_text()
    log.path.write_text(whole + '{"step": 6, "val')
    assert len(log.steps()) == 6
    log.cut(6)
    assert log.path.read_text() == whole


def test_a_missing_log_is_empty(tmp_path):
    log = TrainingLog(tmp_path / "log.jsonl")
    assert log.steps() == log.validations() == []
    log.cut(0)
    assert log.path.read_bytes() == b""


@pytest.mark.parametrize("line", ["garbage", "[1]", "3", "{}", '{"step": "x"}', '{"step": 1, "validation": 3}'])
def test_a_line_that_no_training_writes_is_refused(log, line):
    with log.path.open("a") as file:
        file.write(line + "\n")
    for read in (log.steps, log.validations, lambda: log.cut(3)):
        with pytest.raises(ArtifactError, match=r"log\.jsonl: expected one JSON object per line; got "):
            read()


def test_a_log_that_cannot_be_written_is_an_output_error(tmp_path):
    (tmp_path / "full").symlink_to("/dev/full")
    with pytest.raises(OutputError, match=r"cannot write .*full: No space left on device"):
        TrainingLog(tmp_path / "full").append([{"step": 0}])


def test_every_line_is_valid_json(log):
    with pytest.raises(ValueError, match="not JSON compliant"):
        log.append([{"step": 6, "total": float("nan")}])
    for line in log.path.read_text().splitlines():
        json.loads(line)
