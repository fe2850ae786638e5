"""Tests of the TensorBoard log: the curves as TensorBoard itself reads them, also after an interruption."""

import resource
import signal
import threading

import pytest

from duospacenet.runtime.errors import OutputError
from duospacenet.training.trainer import TrainingStep
from duospacenet.training.watching.step_report import StepReport
from duospacenet.training.watching.validation_scores import ValidationScores

event_accumulator = pytest.importorskip("tensorboard.backend.event_processing.event_accumulator")
tensorboard_log = pytest.importorskip("duospacenet.training.watching.tensorboard_log")


@pytest.fixture(autouse=True)
def excepthook(monkeypatch):
    """The hook for errors in threads, which a log that is not closed does not restore."""
    monkeypatch.setattr(threading, "excepthook", threading.excepthook)
    return threading.excepthook


def report_of(step, loss=None, gradient_norm=1.0):
    result = TrainingStep(step, {"box_0": 1.0, "total": 10.0 - step if loss is None else loss}, gradient_norm, 2)
    return StepReport(result, None, 1e-4, 1e-5, 0.5, 0.1, 0.5, 0.2, 4.0, 10.0, 1.0, None)


def scores_at(step, nds=0.5):
    return ValidationScores(step, "drives", 0.3, nds, 1.5, {"drivable_area": 0.75, "lane_boundary": None})


def curves_in(folder):
    """The points (step, value) of each curve."""
    accumulator = event_accumulator.EventAccumulator(str(folder))
    accumulator.Reload()
    names = accumulator.Tags()["scalars"]
    return {name: [(event.step, round(event.value, 6)) for event in accumulator.Scalars(name)] for name in names}


def test_losses_learning_rates_and_scores_become_curves(tmp_path):
    log = tensorboard_log.TensorBoardLog(tmp_path / "tb", 0, [])
    for step in range(3):
        log.add_step(report_of(step, gradient_norm=None if step == 1 else 2.0))
    log.add_validation(scores_at(3))
    log.close()
    assert curves_in(tmp_path / "tb") == {
        "loss/box_0": [(0, 1.0), (1, 1.0), (2, 1.0)],
        "loss/total": [(0, 10.0), (1, 9.0), (2, 8.0)],
        "learning_rate/backbone": [(step, 1e-5) for step in range(3)],
        "learning_rate/others": [(step, 1e-4) for step in range(3)],
        "step/gradient_norm": [(0, 2.0), (2, 2.0)],
        "step/frames_per_s": [(step, 4.0) for step in range(3)],
        "validation/mAP": [(3, 0.3)],
        "validation/NDS": [(3, 0.5)],
        "validation/mAVE": [(3, 1.5)],
        "validation/IoU drivable_area": [(3, 0.75)],
    }


@pytest.mark.parametrize("validated_at_checkpoint", [True, False])
def test_a_resumed_training_continues_the_curves_without_doubled_steps(tmp_path, validated_at_checkpoint):
    """The checkpoint is after three steps. Two more steps and their validation were lost with the interruption."""
    log = tensorboard_log.TensorBoardLog(tmp_path, 0, [])
    for step in range(5):
        log.add_step(report_of(step))
        if step == 2 and validated_at_checkpoint:
            log.add_validation(scores_at(3))
    log.add_validation(scores_at(5, 0.1))
    log.flush()  # and no `close`: the process was killed
    earlier = [scores_at(3)] if validated_at_checkpoint else []
    log = tensorboard_log.TensorBoardLog(tmp_path, 3, earlier)
    for step in range(3, 6):
        log.add_step(report_of(step, loss=0.5))
    log.add_validation(scores_at(6, 0.7))
    log.close()
    curves = curves_in(tmp_path)
    assert curves["loss/total"] == [(0, 10.0), (1, 9.0), (2, 8.0), (3, 0.5), (4, 0.5), (5, 0.5)]
    assert curves["validation/NDS"] == [(3, 0.5)] * validated_at_checkpoint + [(6, 0.7)]


def test_a_folder_that_cannot_be_written_is_an_output_error(tmp_path):
    (tmp_path / "file").write_text("mine")
    with pytest.raises(OutputError, match=r"cannot write .*file"):
        tensorboard_log.TensorBoardLog(tmp_path / "file", 0, [])


def test_a_full_disk_is_an_output_error_without_a_traceback(tmp_path, capfd, excepthook):
    """A limit of the file size stands for the full disk."""
    log = tensorboard_log.TensorBoardLog(tmp_path, 0, [])
    handler, limits = signal.signal(signal.SIGXFSZ, signal.SIG_IGN), resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, limits[1]))
    try:
        with pytest.raises(OutputError, match=r"cannot write .*: File too large"):
            for step in range(10):
                log.add_step(report_of(step))
                log.flush()
        with pytest.raises(OutputError):
            log.close()
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
        signal.signal(signal.SIGXFSZ, handler)
    assert capfd.readouterr().err == ""
    assert threading.excepthook is excepthook
