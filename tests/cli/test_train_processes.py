"""`duospacenet train` in two processes, as torchrun starts them: output, errors, killed processes and --resume."""

import signal

import pytest
import torch
from safetensors.torch import load_file

from duospacenet.cli.main import run_app
from duospacenet.data.scene_writer import write_scene
from tests.helpers.process_group import start_processes, wait_for_processes
from tests.helpers.processes import start, wait_for
from tests.helpers.train_command import TRAIN_TINY, with_options
from tests.helpers.training_logs import reproducible_lines
from tests.helpers.trainings import synthetic_frames

OPTIONS = ["--batch-size", "2", "--steps", "12", "--save-every", "1", "--set", "ema_decay=0.9"]
# Otherwise the statistics of the image encoder are those of a process's part of the batch.
OPTIONS += ["--set", "backbone_norm_eval=true"]


def train_in_two_processes(arguments, *options):
    return start_processes(["duospacenet.cli.main", *with_options(arguments, *options)])


@pytest.fixture(scope="module")
def arguments(training_scene, initial_weights):
    """The arguments of a training of twelve steps, without --out."""
    return [*with_options(TRAIN_TINY, *OPTIONS), "--source", str(training_scene), "--weights", str(initial_weights)]


@pytest.fixture(scope="module")
def uninterrupted(arguments, tmp_path_factory):
    """The folder of a training in two processes, and the exit code and output of both."""
    out = tmp_path_factory.mktemp("two") / "out"
    return out, wait_for_processes(train_in_two_processes(arguments, "--out", out))


@pytest.fixture(scope="module")
def one_process(arguments, tmp_path_factory):
    """The folder of a training in one process."""
    out = tmp_path_factory.mktemp("one") / "out"
    assert run_app(with_options(arguments, "--out", out)) == 0
    return out


def losses_of(out):
    """The losses of each step, without the norm of the gradient."""
    return [{name: loss for name, loss in line.items() if name != "gradient_norm"} for line in reproducible_lines(out)]


def test_only_the_first_process_writes_messages(uninterrupted):
    out, ((code, output, messages), second) = uninterrupted
    assert code == 0, messages
    assert output.split() == f"wrote {out}/weights.safetensors after 12 steps".split()
    assert "step 12 of 12, epoch 8.00: loss" in messages
    assert second == (0, "", "")


def test_two_processes_have_the_losses_of_one_process(uninterrupted, one_process):
    for number, (losses, expected) in enumerate(zip(losses_of(uninterrupted[0]), losses_of(one_process), strict=True)):
        # A rounding error of 1e-7 in the weights changes single losses by 1e-3 after four steps, and by 0.1 after ten.
        assert number > 2 or losses == pytest.approx(expected, rel=1e-3)
        assert losses["total"] == pytest.approx(expected["total"], rel=0.01)


def test_a_killed_process_resumes_to_the_same_bits(one_process, arguments, tmp_path):
    out = tmp_path / "out"
    process = start(with_options(arguments, "--out", out))
    wait_for(lambda: process.poll() is not None or (out / "checkpoint.pt").exists(), timeout_s=240)
    process.kill()
    assert process.wait(60) == -signal.SIGKILL
    assert run_app(with_options(arguments, "--out", out, "--resume")) == 0
    assert reproducible_lines(out) == reproducible_lines(one_process)
    ours, expected = (load_file(folder / "weights.safetensors") for folder in (out, one_process))
    assert [name for name, tensor in expected.items() if not torch.equal(tensor, ours[name])] == []


@pytest.mark.slow
def test_the_other_process_ends_when_one_is_killed_and_the_resumed_training_has_the_same_losses(
    uninterrupted, arguments, tmp_path
):
    """First one process is killed. The training is resumed, and both are killed. It is resumed again."""
    out = tmp_path / "out"
    checkpoint = out / "checkpoint.pt"
    processes = train_in_two_processes(arguments, "--out", out)
    wait_for(lambda: processes[0].poll() is not None or checkpoint.exists(), timeout_s=240)
    processes[1].kill()
    (code, _, messages), (killed, _, _) = wait_for_processes(processes)
    assert (code, killed) == (130, -signal.SIGKILL), messages
    assert "expected an answer from all processes of the training; got none from one of them" in messages
    assert "Traceback" not in messages
    saved_ns = checkpoint.stat().st_mtime_ns
    processes = train_in_two_processes(arguments, "--out", out, "--resume")
    wait_for(lambda: processes[0].poll() is not None or checkpoint.stat().st_mtime_ns > saved_ns, timeout_s=240)
    for process in processes:
        process.kill()
    wait_for_processes(processes)
    resumed = wait_for_processes(train_in_two_processes(arguments, "--out", out, "--resume"))
    assert [code for code, _, _ in resumed] == [0, 0], resumed
    for losses, expected in zip(losses_of(out), losses_of(uninterrupted[0]), strict=True):
        assert losses == pytest.approx(expected, rel=1e-3)


def test_an_error_in_one_process_ends_both_with_its_exit_code_and_one_message(tmp_path, arguments):
    """The image of one frame is damaged, and only the second process trains on this frame."""
    scene = tmp_path / "scene"
    write_scene(scene, synthetic_frames(1, 4))
    (scene / "images" / "CAM_FRONT" / "000003.png").write_bytes(b"damaged")
    results = wait_for_processes(train_in_two_processes(arguments, "--source", scene, "--out", tmp_path / "out"))
    assert [code for code, _, _ in results] == [3, 3], results
    (_, _, first), (_, _, second) = results
    assert second.startswith("error: ")
    assert "000003.png" in second
    assert "error" not in first


def test_a_wrong_call_has_one_message(tmp_path, arguments):
    results = wait_for_processes(train_in_two_processes(arguments, "--out", tmp_path / "out", "--batch-size", "3"))
    assert [code for code, _, _ in results] == [2, 2]
    (message,) = [messages for _, _, messages in results if messages]
    assert message.startswith("error: --batch-size: expected a multiple of 2 (processes: 2, accumulation steps: 1)")
