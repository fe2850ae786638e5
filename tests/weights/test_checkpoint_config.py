"""The configuration in the metadata of a checkpoint can be read without the weights."""

import json

import pytest
import torch

from duospacenet.model import PRESETS, DuoSpaceNetConfig
from duospacenet.weights import CheckpointError, read_config, save_checkpoint
from tests.helpers.checkpoints import write


def test_the_configuration_is_the_one_that_was_saved(tmp_path, model):
    config = PRESETS["nano"]
    save_checkpoint(tmp_path / "weights.safetensors", model, {"config": json.dumps(config.to_dict())})
    assert DuoSpaceNetConfig.from_dict(read_config(tmp_path / "weights.safetensors")) == config
    assert read_config(str(tmp_path / "weights.safetensors")) == config.to_dict()


@pytest.mark.parametrize("metadata", [None, {"trained": "true"}])
def test_a_checkpoint_without_a_configuration_has_none(tmp_path, model, metadata):
    save_checkpoint(tmp_path / "weights.safetensors", model, metadata)
    assert read_config(tmp_path / "weights.safetensors") is None


def test_a_pickle_has_no_configuration_and_is_not_read(tmp_path, monkeypatch):
    path = write(tmp_path / "weights.pth", {"config": {"preset": "nano"}})
    monkeypatch.setattr(torch, "load", lambda *_, **__: pytest.fail("the pickle was read"))
    assert read_config(path) is None


@pytest.mark.parametrize("text", ["", "{", "nano", "[1, 2]", "null", '"nano"', "[" * 100_000])
def test_metadata_that_is_not_a_json_object_is_refused(tmp_path, model, text):
    save_checkpoint(tmp_path / "weights.safetensors", model, {"config": text})
    with pytest.raises(CheckpointError, match=r"weights\.safetensors: expected a JSON object in the metadata field"):
        read_config(tmp_path / "weights.safetensors")


def test_a_damaged_file_is_refused(tmp_path):
    path = tmp_path / "weights.safetensors"
    path.write_bytes(b"not safetensors")
    with pytest.raises(CheckpointError, match="got 15 bytes: the file is truncated, damaged or of another kind"):
        read_config(path)


def test_a_missing_file_is_refused(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"expected a checkpoint, .* got no such file"):
        read_config(tmp_path / "weights.safetensors")
