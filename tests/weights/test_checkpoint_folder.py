"""A folder is a checkpoint if it holds one; folders of other frameworks are named, with a way out that works."""

import os
import re
import shlex
import subprocess
import sys

import pytest
import torch
import torch.distributed.checkpoint as distributed

from duospacenet.weights import CheckpointError, load_checkpoint
from tests.helpers.checkpoints import altered, assert_holds, assert_refused, refusal, write


@pytest.mark.parametrize("name", ["model.safetensors", "pytorch_model.bin"])
def test_the_single_checkpoint_of_a_folder_is_read(tmp_path, model, weights, name):
    write(tmp_path / name, weights)
    (tmp_path / "config.json").write_text("{}")
    write(tmp_path / "optimizer.bin", {"a": torch.zeros(3)})
    load_checkpoint(tmp_path, model)
    assert_holds(model, weights)


def test_safetensors_are_preferred_to_a_pickle(tmp_path, model, weights):
    write(tmp_path / "model.safetensors", weights)
    write(tmp_path / "pytorch_model.bin", altered(weights))
    load_checkpoint(tmp_path, model)
    assert_holds(model, weights)


def test_a_folder_with_two_indices_is_refused(tmp_path, model):
    for name in ("a", "b"):
        (tmp_path / f"{name}.safetensors.index.json").write_text("{}")
    assert_refused(tmp_path, model, "a.safetensors.index.json, b.safetensors.index.json", "Name one of them")


def test_a_folder_with_other_files_lists_its_checkpoints(tmp_path, model):
    for name in ("epoch_1.pth", "epoch_2.pth", "log.txt"):
        (tmp_path / name).write_bytes(b"anything")
    words = ("got a folder", "Name a file in it: epoch_1.pth, epoch_2.pth.")
    assert_refused(tmp_path, model, *words, error=FileNotFoundError)


@pytest.mark.parametrize("name", ["", "__0_0.distcp", ".metadata"])
@pytest.mark.filterwarnings("ignore")
def test_a_distributed_checkpoint_is_named_and_the_advice_works(tmp_path, model, weights, name):
    folder = tmp_path / "my run"
    distributed.save(dict(weights), checkpoint_id=folder, no_dist=True)
    message = refusal(folder / name, model)
    assert "a distributed checkpoint, as FSDP saves it" in message
    if not name:  # it takes seconds
        _, *arguments = shlex.split(re.search(r"`(python .*)`", message)[1])
        subprocess.run([sys.executable, *arguments], check=True, cwd=tmp_path, capture_output=True)
        load_checkpoint(tmp_path / "tensors.pth", model)
        assert_holds(model, weights)


@pytest.mark.parametrize("script", [True, False])
def test_a_checkpoint_of_deepspeed_is_named_with_its_own_script(tmp_path, model, script):
    (tmp_path / "bf16_zero_pp_rank_0_mp_rank_00_optim_states.pt").write_bytes(b"anything")
    program = shlex.quote(str(tmp_path / "zero_to_fp32.py")) if script else "-m deepspeed.utils.zero_to_fp32"
    if script:
        (tmp_path / "zero_to_fp32.py").touch()
    assert_refused(tmp_path, model, "a checkpoint of DeepSpeed", f"`python {program} {tmp_path} converted`")


def test_a_bundle_and_a_saved_model_are_named(tmp_path, model):
    (tmp_path / "manifest.json").touch()
    (tmp_path / "backbone.onnx").touch()
    assert_refused(tmp_path, model, "got a bundle, which holds graphs")
    (tmp_path / "saved_model.pb").touch()
    assert_refused(tmp_path, model, "a TensorFlow SavedModel")


# --- Files that are not opened --------------------------------------------------------------------------------------


def test_a_pipe_and_a_sparse_file_of_60_gb_are_refused_without_reading(tmp_path, model):
    os.mkfifo(tmp_path / "pipe.pth")
    with (tmp_path / "sparse.safetensors").open("wb") as file:
        file.truncate(60 * 10**9)
    for name, words in (("pipe.pth", "a named pipe"), ("sparse.safetensors", "got 60000000000")):
        with pytest.raises(CheckpointError, match=words):
            load_checkpoint(tmp_path / name, model)
    with pytest.raises(CheckpointError, match="a device"):
        load_checkpoint("/dev/zero", model)
