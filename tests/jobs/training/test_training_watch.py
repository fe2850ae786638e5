"""The lines about the steps and validations of a training."""

from dataclasses import replace

import pytest

from duospacenet.jobs.training.training_watch import describe_step, report_scores, train_with_curves
from duospacenet.training.trainer import TrainingStep
from duospacenet.training.watching.step_report import StepReport
from duospacenet.training.watching.validation_scores import ValidationScores
from tests.helpers.trainings import SIX_STEPS, record_with, start_training_folder


def report_of(step, total=2.0, **changes):
    result = TrainingStep(step, {"box_0": 1.0, "total": total}, 1.0, 2)
    plain = StepReport(result, 1.25, 4e-4, 4e-5, 0.6, 0.1, 0.5, 0.2, 3.9, 1980.0, 1.0, None)
    return replace(plain, **changes)


def followed(tmp_path, numbers, num_steps):
    """The lines, and the returned loss, of a training in which the loss of each step is its number."""
    folder, lines = start_training_folder(tmp_path / "out"), []
    folder.record = record_with(replace(SIX_STEPS, steps=num_steps))
    loss = train_with_curves(folder, (report_of(number, float(number)) for number in numbers), lines.append)
    return lines, loss


def test_a_line_says_how_far_the_training_is_and_how_fast_it_goes():
    assert describe_step(report_of(199), 4000, 9.8714) == (
        "step 200 of 4000, epoch 1.25: loss 9.871, learning rate 4.0e-04, 0.50 s per step, 3.9 frames/s, 33 min left"
    )


def test_a_training_on_a_gpu_without_epochs_names_the_memory_of_the_gpu():
    assert describe_step(report_of(0, epoch=None, gpu_memory_gb=11.26), 10, 1.0).startswith(
        "step 1 of 10: loss 1.000, learning rate 4.0e-04, 0.50 s per step, 3.9 frames/s, 11.3 GB on the GPU, "
    )


@pytest.mark.parametrize(("share", "text"), [(0.2, None), (0.21, "waiting for data 21% of the time"), (0.9, "90%")])
def test_a_large_share_of_waiting_for_data_is_reported(share, text):
    line = describe_step(report_of(0, waiting_share=share), 10, 1.0)
    assert ("waiting for data" in line) == (text is not None)
    assert text is None or text in line
    assert text is None or "--workers" in line


def test_the_first_steps_every_hundredth_and_the_last_have_a_line(tmp_path):
    lines, loss = followed(tmp_path, range(245), 245)
    assert [int(line.split()[1]) for line in lines] == [1, 3, 10, 30, 100, 200, 245]
    assert lines[1].startswith("step 3 of 245, epoch 1.25: loss 1.000,")  # the mean of 0, 1 and 2
    assert loss == pytest.approx(194.5)  # the mean of the newest hundred steps, 145 to 244


def test_a_resumed_training_has_lines_about_its_first_steps(tmp_path):
    lines, _ = followed(tmp_path, range(1234, 1250), 5000)
    assert [int(line.split()[1]) for line in lines] == [1235, 1237, 1244]


def test_a_training_without_steps_has_no_lines_and_no_loss(tmp_path):
    assert followed(tmp_path, (), 6) == ([], None)
    assert (tmp_path / "out" / "losses.png").exists()


def test_a_validation_has_a_line_with_its_scores():
    lines, scores = [], ValidationScores(600, "drives", 0.25, 0.5, 1.5, {"drivable_area": 0.75})
    report_scores(lines.append)(scores, True)
    report_scores(lines.append)(scores, False)
    text = "validation after step 600: mAP 0.250, NDS 0.500, mAVE 1.500 m/s, IoU drivable area 0.750"
    assert lines == [f"{text}; the best NDS so far", text]
