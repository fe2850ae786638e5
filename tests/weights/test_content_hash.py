"""The content hash of safetensors files that this toolkit writes."""

import json
import random
import struct

import pytest
import torch
from safetensors.torch import load_file, save_file
from torch import nn

from duospacenet.weights import CheckpointError, load_checkpoint, save_checkpoint
from duospacenet.weights.checkpoint_file import read_file
from duospacenet.weights.content_hash import HASH_KEY, is_intact, with_content_hash


def small_model(seed=0):
    torch.manual_seed(seed)
    return nn.Sequential(nn.Conv2d(3, 4, 3), nn.BatchNorm2d(4), nn.Linear(4, 2))


@pytest.fixture
def saved(tmp_path):
    path = tmp_path / "weights.safetensors"
    save_checkpoint(path, small_model(), {"trained": "true", "step": "7"})
    return path


def test_a_saved_file_can_be_loaded(saved):
    model = small_model(1)
    load_checkpoint(saved, model)
    assert all(torch.equal(value, small_model().state_dict()[name]) for name, value in model.state_dict().items())


def test_any_flipped_bit_of_the_tensors_is_refused(saved):
    content = saved.read_bytes()
    (header_size,) = struct.unpack("<Q", content[:8])
    generator = random.Random(0)
    part = (len(content) - header_size - 8) / 60
    for number in range(60):
        damaged = bytearray(content)
        damaged[8 + header_size + int(part * (number + generator.random()))] ^= 1 << generator.randrange(8)
        saved.write_bytes(damaged)
        with pytest.raises(
            CheckpointError, match=r"weights\.safetensors: expected the content that the hash .*damaged"
        ):
            load_checkpoint(saved, small_model())


def test_changed_metadata_are_refused(saved):
    saved.write_bytes(saved.read_bytes().replace(b'"trained":"true"', b'"trained":"TRUE"'))
    with pytest.raises(CheckpointError, match="expected the content that the hash in its metadata"):
        read_file(saved)


def test_a_changed_name_or_shape_changes_the_hash():
    tensor = torch.arange(6.0)
    metadata = with_content_hash({"a": tensor}, {"b": "c"})
    assert is_intact({"a": tensor}, metadata)
    for other in ({"b": tensor}, {"a": tensor.reshape(2, 3)}, {"a": tensor.view(torch.int32)}, {}):
        assert not is_intact(other, metadata)


def test_a_file_of_another_program_has_no_hash_and_is_read(saved):
    tensors = load_file(saved)
    save_file(tensors, saved, {"format": "pt"})
    content, metadata = read_file(saved)
    assert HASH_KEY not in metadata
    assert content.keys() == tensors.keys()


def test_the_order_of_the_metadata_does_not_matter(saved):
    """safetensors writes metadata in a random order."""
    header = saved.read_bytes()
    (size,) = struct.unpack("<Q", header[:8])
    fields = json.loads(header[8 : 8 + size])["__metadata__"]
    tensors = load_file(saved)
    assert is_intact(tensors, dict(sorted(fields.items())))
    assert is_intact(tensors, dict(sorted(fields.items(), reverse=True)))
