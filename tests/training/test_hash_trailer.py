"""The hash of the training state: damaged files are refused, and no interruption separates a file from its hash."""

import os
import random
import signal
import time

import pytest
import torch

from duospacenet.runtime.errors import ArtifactError
from duospacenet.training.hash_trailer import TRAILER_BYTES, append_hash, check_hash
from tests.helpers.trainings import SIX_STEPS, new_trainer, start_training_folder

ADVICE = r"Restore the file from a copy, or start a new training in another --out\. --weights .*weights\.safetensors"


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    """A folder with a saved training, and the bytes of its checkpoint."""
    folder = start_training_folder(tmp_path_factory.mktemp("hash") / "saved")
    folder.save(new_trainer(SIX_STEPS))
    return folder, (folder.path / "checkpoint.pt").read_bytes()


@pytest.fixture(scope="module")
def trainer():
    return new_trainer(SIX_STEPS)


def test_the_trailer_is_the_sha256_of_the_content(tmp_path):
    """The sha256 of "abc" is the first example of FIPS 180."""
    path = tmp_path / "file"
    path.write_bytes(b"abc")
    append_hash(path)
    digest = b"ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"
    assert path.read_bytes() == b"abc\nsha256 " + digest + b"\n"
    with path.open("rb") as file:
        check_hash(file)
        assert file.tell() == 0


def test_any_flipped_bit_in_the_training_state_is_refused(saved, trainer):
    """60 bits over the whole file, and one in each part of the trailer."""
    folder, content = saved
    generator = random.Random(0)
    part = len(content) / 60
    offsets = [int(part * (k + generator.random())) for k in range(60)]
    offsets += [len(content) - k for k in (1, 2, 65, 66, TRAILER_BYTES, TRAILER_BYTES + 1)]
    assert all(0 <= offset < len(content) for offset in offsets)
    for offset in offsets:
        damaged = bytearray(content)
        damaged[offset] ^= 1 << generator.randrange(8)
        (folder.path / "checkpoint.pt").write_bytes(damaged)
        with pytest.raises(ArtifactError, match=rf"checkpoint\.pt: expected the state .* got \d+ bytes .*{ADVICE}"):
            folder.resume(trainer)
    (folder.path / "checkpoint.pt").write_bytes(content)
    folder.resume(trainer)


@pytest.mark.parametrize("share", [0, 1e-6, 0.01, 0.25, 0.5, 0.99])
def test_a_truncated_training_state_is_refused(saved, trainer, share):
    folder, content = saved
    for part in (content[: int(share * len(content))], content[: -1 - int(share * TRAILER_BYTES)], content + b"\n"):
        (folder.path / "checkpoint.pt").write_bytes(part)
        with pytest.raises(ArtifactError, match=rf"checkpoint\.pt: .* got {len(part)} bytes .*{ADVICE}"):
            folder.resume(trainer)


def test_a_state_killed_at_any_moment_of_saving_has_its_own_hash(saved, tmp_path):
    """A child process saves two states in turn, and is killed ten times. Each time, one of them is complete."""
    folder = start_training_folder(tmp_path / "killed")
    trainer = new_trainer(SIX_STEPS)
    folder.save(trainer)
    generator = random.Random(1)
    for _ in range(10):
        child = os.fork()
        if not child:
            try:
                while True:
                    trainer.step = 5 - trainer.step
                    folder.save(trainer)
            finally:
                os._exit(1)  # never continue the test run in the child
        time.sleep(generator.uniform(0.01, 0.2))
        os.kill(child, signal.SIGKILL)
        _, status = os.waitpid(child, 0)
        assert os.WTERMSIG(status) == signal.SIGKILL
        trainer.step = -1
        folder.resume(trainer)
        assert trainer.step in (0, 5)


def test_a_save_without_its_hash_never_replaces_the_state(saved, trainer, monkeypatch):
    folder, content = saved
    (folder.path / "checkpoint.pt").write_bytes(content)

    def interrupted(_):
        raise KeyboardInterrupt

    monkeypatch.setattr("duospacenet.training.training_folder.append_hash", interrupted)
    with pytest.raises(KeyboardInterrupt):
        folder.save(trainer)
    assert (folder.path / "checkpoint.pt").read_bytes() == content
    assert not list(folder.path.glob(".*"))


def test_torch_can_still_read_the_file(saved):
    folder, content = saved
    (folder.path / "checkpoint.pt").write_bytes(content)
    assert torch.load(folder.path / "checkpoint.pt", weights_only=True)["step"] == 0
