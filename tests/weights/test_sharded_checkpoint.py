"""Sharded checkpoints are read through their index; an index that disagrees with its shards is refused by name."""

import hashlib
import json
import os
import subprocess

import pytest
import torch
from safetensors.torch import save_file

from duospacenet.weights import load_checkpoint, read_config
from duospacenet.weights.provenance import hash_checkpoint
from tests.helpers.checkpoints import assert_holds, assert_refused, prefixed

INDEX = "model.safetensors.index.json"
SHARDS = [f"model-{number:05d}-of-00003.safetensors" for number in (1, 2, 3)]


def write_shards(folder, tensors, shards=SHARDS, index=INDEX, metadata=None):
    """Every third tensor goes to the same shard. Returns the index, which has the total size."""
    folder.mkdir(exist_ok=True)
    weight_map = {name: shards[position % len(shards)] for position, name in enumerate(tensors)}
    for shard in shards:
        part = {name: tensors[name].contiguous() for name in tensors if weight_map[name] == shard}
        if shard.endswith(".bin"):
            torch.save(part, folder / shard)
        else:
            save_file(part, folder / shard, metadata)
    total = sum(tensor.numel() * tensor.element_size() for tensor in tensors.values())
    (folder / index).write_text(json.dumps({"metadata": {"total_size": total}, "weight_map": weight_map}))
    return folder / index


@pytest.fixture
def index(tmp_path, weights):
    """The index of a checkpoint in three shards."""
    return write_shards(tmp_path / "model", weights)


def edit_index(index, edit):
    content = json.loads(index.read_text())
    edit(content)
    index.write_text(json.dumps(content))


@pytest.mark.parametrize("name", ["the index", "the folder"])
@pytest.mark.parametrize("prefix", ["", "model.module."])
def test_the_shards_of_an_index_are_one_checkpoint(tmp_path, model, weights, name, prefix):
    index = write_shards(tmp_path / "model", prefixed(prefix, weights), metadata={"format": "pt", "trained": "true"})
    report = load_checkpoint(index if name == "the index" else index.parent, model)
    assert_holds(model, weights)
    assert report.metadata == {"format": "pt", "trained": "true"}


def test_shards_of_torch_save_are_read_too(tmp_path, model, weights):
    shards = ["pytorch_model-00001-of-00002.bin", "pytorch_model-00002-of-00002.bin"]
    load_checkpoint(write_shards(tmp_path, weights, shards, "pytorch_model.bin.index.json"), model)
    assert_holds(model, weights)


def test_an_index_with_another_name_and_links_to_its_shards_are_read(tmp_path, model, weights, index):
    """Hugging Face's cache has links to files with other names."""
    other = tmp_path / "snapshot"
    other.mkdir()
    for shard in SHARDS:
        (other / shard).symlink_to(index.parent / shard)
    (other / "weights").symlink_to(index)
    load_checkpoint(other / "weights", model)
    assert_holds(model, weights)


def test_safetensors_are_preferred_in_a_folder_with_both_formats(tmp_path, model, weights):
    write_shards(tmp_path, weights)
    zeros = {name: torch.zeros_like(tensor) for name, tensor in weights.items()}
    write_shards(tmp_path, zeros, ["pytorch_model-00001-of-00001.bin"], "pytorch_model.bin.index.json")
    load_checkpoint(tmp_path, model)
    assert_holds(model, weights)


def test_the_configuration_is_found_in_the_metadata_of_the_shards(tmp_path, weights):
    index = write_shards(tmp_path, weights, metadata={"config": '{"preset": "mine"}'})
    assert read_config(index) == read_config(tmp_path) == {"preset": "mine"}


# --- Refused --------------------------------------------------------------------------------------------------------


def test_a_missing_shard_is_named(index, model):
    (index.parent / SHARDS[1]).unlink()
    assert_refused(index, model, SHARDS[1], "no such file", name=False)


def test_a_shard_that_the_index_does_not_list_is_named(index, model):
    (index.parent / "model-00002-of-00002.safetensors").write_bytes(b"of an earlier download")
    assert_refused(index, model, "model-00002-of-00002.safetensors", "got this one too", name=False)


def test_files_of_other_checkpoints_in_the_folder_are_no_shards(index, model, weights):
    for name in ("model.safetensors", "optimizer-00001-of-00002.safetensors", "model-00001-of-00002.bin", "readme.md"):
        (index.parent / name).write_bytes(b"something else")
    load_checkpoint(index, model)
    assert_holds(model, weights)


def test_a_damaged_shard_is_named(index, model):
    shard = index.parent / SHARDS[2]
    shard.write_bytes(shard.read_bytes()[:-100])
    assert_refused(index, model, SHARDS[2], "truncated", name=False)


@pytest.mark.parametrize(
    "name", ["../{}", "/etc/{}", "sub/{}", "..", ".", "", "sub\\{}", "{}\n", "./{}", "\ud800", "{}/", "~/\x1b[2J"]
)
def test_a_shard_name_outside_the_folder_is_refused(index, model, name):
    def edit(content):
        content["weight_map"]["conv1.weight"] = name.format(SHARDS[0])

    edit_index(index, edit)
    before = {path: path.read_bytes() for path in index.parent.iterdir()}
    message = assert_refused(index, model, "weight_map", "conv1.weight")
    assert message.isprintable()
    assert before == {path: path.read_bytes() for path in index.parent.iterdir()}


DISAGREEMENTS = {
    "a tensor in no shard": (
        lambda i: i["weight_map"].update({"layer9.weight": SHARDS[0]}),
        (SHARDS[0], "it lacks 'layer9.weight'"),
    ),
    "a tensor in another shard": (
        lambda i: i["weight_map"].update({"conv1.weight": SHARDS[2]}),
        (SHARDS[0], "it also has 'conv1.weight'"),
    ),
    "a tensor that is not listed": (
        lambda i: i["weight_map"].pop("conv1.weight"),
        (SHARDS[0], "it also has 'conv1.weight'"),
    ),
    "another size": (lambda i: i["metadata"].update(total_size=1), (INDEX, "metadata.total_size", "got 1")),
    "no tensors": (lambda i: i.update(weight_map={}), (INDEX, "weight_map", "got none")),
    "a list of tensors": (lambda i: i.update(weight_map=["conv1.weight"]), (INDEX, "weight_map")),
    "a number for a name": (lambda i: i["weight_map"].update({"conv1.weight": 3}), (INDEX, "weight_map.conv1.weight")),
    "itself as a shard": (lambda i: i.update(weight_map={"conv1.weight": INDEX}), (INDEX, "got an index of shards")),
}


@pytest.mark.parametrize("case", DISAGREEMENTS)
def test_an_index_that_disagrees_with_its_shards_is_refused(index, model, case):
    edit, words = DISAGREEMENTS[case]
    edit_index(index, edit)
    assert_refused(index, model, *words, name=False)


def test_a_pipe_as_a_shard_is_refused_without_waiting(index, model):
    (index.parent / SHARDS[0]).unlink()
    os.mkfifo(index.parent / SHARDS[0])
    assert_refused(index, model, SHARDS[0], "a named pipe", name=False)


def test_an_index_with_too_few_shards_is_refused(tmp_path, model, weights):
    index = write_shards(tmp_path, weights, ["model-00001-of-00002.safetensors"])
    assert_refused(index, model, "expected 2 shards, as the name model-00001-of-00002.safetensors says; it lists 1")


def test_a_shard_with_more_than_tensors_is_refused(tmp_path, model, weights):
    shards = ["pytorch_model-00001-of-00001.bin"]
    index = write_shards(tmp_path, weights, shards, "pytorch_model.bin.index.json")
    torch.save({"state_dict": dict(weights)}, tmp_path / shards[0])
    assert_refused(index, model, shards[0], "named tensors only", name=False)


@pytest.mark.parametrize("with_index", [True, False])
def test_one_shard_by_itself_is_not_a_checkpoint(index, model, with_index):
    if not with_index:
        index.unlink()
    words = f"Name the index {index}" if with_index else f"Copy the index {INDEX} beside it"
    assert_refused(index.parent / SHARDS[1], model, "it is shard 2 of 3", words)


# --- Hash -----------------------------------------------------------------------------------------------------------


def test_the_hash_is_that_of_the_lines_of_sha256sum(index):
    shell = f"LC_ALL=C; export LC_ALL; sha256sum {' '.join(SHARDS)} {INDEX} | sha256sum"
    expected = subprocess.run(shell, shell=True, cwd=index.parent, capture_output=True, text=True).stdout.split()[0]
    assert hash_checkpoint(index) == hash_checkpoint(index.parent) == expected


def test_the_hash_changes_with_each_file(index):
    original = hash_checkpoint(index)
    for path in sorted(index.parent.iterdir()):
        content = path.read_bytes()
        path.write_bytes(content + b" ")
        assert hash_checkpoint(index) != original
        path.write_bytes(content)
    assert hash_checkpoint(index) == original


def test_the_hash_of_a_single_file_is_its_sha256(tmp_path, weights):
    save_file(dict(weights), tmp_path / "model.safetensors")
    expected = hashlib.sha256((tmp_path / "model.safetensors").read_bytes()).hexdigest()
    assert hash_checkpoint(tmp_path / "model.safetensors") == hash_checkpoint(tmp_path) == expected
