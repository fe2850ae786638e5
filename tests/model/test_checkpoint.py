"""Checkpoints: back to the bit, or refused with a message that names the file and the tensor."""

import copy
import json
import os
import pickle
import struct
import zipfile

import pytest
import torch
from safetensors.torch import save_file
from samples import drawn

from duospacenet.model import PRESETS, CheckpointError, DuoSpaceNet, load_checkpoint, randomise, save_checkpoint
from duospacenet.model.config import ResNetConfig
from duospacenet.model.resnet import ResNet

FIRST = "conv1.weight"  # (8, 3, 7, 7)
LAST = "layer4.0.bn2.bias"  # (64,)
SUFFIXES = [".pth", ".safetensors"]


@pytest.fixture(scope="module")
def weights():
    return network(seed=1).state_dict()


@pytest.fixture
def model():
    """A small part of the whole, with convolutions, norms and counters: the file's faults are the same."""
    return network(seed=2)


def network(seed):
    return drawn(ResNet(ResNetConfig("basic", (1, 1, 1, 1), width=8)), seed)


def write(path, tensors):
    if path.suffix == ".safetensors":
        save_file({name: tensor.contiguous() for name, tensor in tensors.items()}, path)
    else:
        torch.save(tensors, path)
    return path


def assert_holds(model, tensors):
    for name, tensor in model.state_dict().items():
        assert torch.equal(tensor, tensors[name]), name


def assert_refused(path, model, *words, error=CheckpointError):
    """Refused with these words and the file's name, and the model is as it was."""
    before = copy.deepcopy(model.state_dict())
    with pytest.raises(error) as refusal:
        load_checkpoint(path, model)
    for word in (path.name, *words):
        assert word in str(refusal.value)
    assert_holds(model, before)


# --- Back to the bit ----------------------------------------------------------------------------------------------


def test_what_is_saved_comes_back_to_the_bit(tmp_path, tiny_model):
    save_checkpoint(tmp_path / "weights.safetensors", tiny_model, {"epoch": "24", "training": "none"})
    model = randomise(DuoSpaceNet(PRESETS["tiny"]), 7)
    metadata = load_checkpoint(tmp_path / "weights.safetensors", model)
    assert metadata == {"epoch": "24", "training": "none"}
    assert_holds(model, tiny_model.state_dict())


@pytest.mark.parametrize("wrap", [lambda t: t, lambda t: {"state_dict": t, "epoch": 3}], ids=["plain", "wrapped"])
@pytest.mark.parametrize("suffix", [".pth", ".pt"])
def test_a_pickled_state_dict_is_loaded_plain_or_under_its_key(tmp_path, model, weights, suffix, wrap):
    assert load_checkpoint(write(tmp_path / f"weights{suffix}", wrap(weights)), model) == {}
    assert_holds(model, weights)


def test_the_path_may_be_a_string(tmp_path, model, weights):
    load_checkpoint(str(write(tmp_path / "weights.pth", weights)), model)
    assert_holds(model, weights)


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_half_precision_is_widened(tmp_path, model, weights, suffix):
    halves = {name: tensor.half() if tensor.is_floating_point() else tensor for name, tensor in weights.items()}
    load_checkpoint(write(tmp_path / f"weights{suffix}", halves), model)
    assert_holds(model, {name: tensor.to(weights[name].dtype) for name, tensor in halves.items()})


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_batch_counters_may_be_absent(tmp_path, model, weights, suffix):
    without = {name: tensor for name, tensor in weights.items() if not name.endswith("num_batches_tracked")}
    assert len(without) < len(weights)
    load_checkpoint(write(tmp_path / f"weights{suffix}", without), model)
    assert_holds(model, weights)


# --- What does not fit --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize("name", [FIRST, LAST, "layer2.0.downsample.1.running_var", "layer3.0.bn1.weight"])
def test_a_missing_tensor_is_refused_by_name(tmp_path, model, weights, suffix, name):
    path = write(tmp_path / f"weights{suffix}", {key: tensor for key, tensor in weights.items() if key != name})
    assert_refused(path, model, "1 missing", name)


@pytest.mark.parametrize(
    "name",
    [
        "image_encoder.neck.extra.bias",
        "lifter.reduction.weight",
        "queries.pose",
        "decoder.layers.1.pv_recurrence.mlp.4.weight",
        "segmentation.heads.lane_boundary.3.bias",
    ],
)
def test_a_tensor_missing_of_a_whole_model_is_refused_by_name(tmp_path, tiny_model, name):
    tensors = {key: tensor for key, tensor in tiny_model.state_dict().items() if key != name}
    assert_refused(write(tmp_path / "weights.pth", tensors), copy.deepcopy(tiny_model), "1 missing", name)


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_an_unexpected_tensor_is_refused_by_name(tmp_path, model, weights, suffix):
    path = write(tmp_path / f"weights{suffix}", weights | {"depth_head.weight": torch.zeros(3)})
    assert_refused(path, model, "1 unexpected", "depth_head.weight")


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize("shape", [(8, 3, 7, 6), (3, 8, 7, 7), (1176,), (), (0,), (1, 8, 3, 7, 7)])
def test_a_misshapen_tensor_is_refused_with_both_shapes(tmp_path, model, weights, suffix, shape):
    path = write(tmp_path / f"weights{suffix}", weights | {FIRST: torch.zeros(shape)})
    assert_refused(path, model, "1 mis-shaped", FIRST, "expected (8, 3, 7, 7)", f"got {shape}")


def test_a_tensor_that_would_broadcast_is_refused(tmp_path, model, weights):
    path = write(tmp_path / "weights.pth", weights | {FIRST: torch.zeros(1, 3, 7, 7)})
    assert_refused(path, model, "mis-shaped", FIRST)


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize("name", [FIRST, LAST, "bn1.running_var"])
@pytest.mark.parametrize("number", [float("nan"), float("inf"), -float("inf")])
def test_a_tensor_with_one_broken_number_is_refused_by_name(tmp_path, model, weights, suffix, name, number):
    broken = weights[name].clone()
    broken.view(-1)[-1] = number
    assert_refused(write(tmp_path / f"weights{suffix}", weights | {name: broken}), model, "1 not finite", name)


def test_every_fault_is_told_at_once_and_long_lists_are_cut(tmp_path, model, weights):
    """Of layer2 go 3 convolutions and 3 norms of 4 tensors: 15."""
    kept = {name: tensor for name, tensor in weights.items() if not name.startswith("layer2.")}
    path = write(tmp_path / "weights.pth", kept | {"extra": torch.full((1,), torch.nan), FIRST: torch.zeros(2)})
    assert_refused(path, model, "15 missing", "and 10 more", "1 unexpected: extra", "1 mis-shaped")


def test_weights_of_another_width_are_refused(tmp_path, model):
    other = ResNet(ResNetConfig("basic", (1, 1, 1, 1), width=4))
    path = write(tmp_path / "weights.pth", other.state_dict())
    assert_refused(path, model, "mis-shaped", "conv1.weight (expected (8, 3, 7, 7), got (4, 3, 7, 7))")


# --- What cannot be read ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_a_missing_file_is_reported_as_such(tmp_path, model, suffix):
    assert_refused(tmp_path / f"weights{suffix}", model, error=FileNotFoundError)


def test_a_folder_is_no_checkpoint(tmp_path, model):
    assert_refused(tmp_path, model, error=FileNotFoundError)


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize("share", [0, 0.25, 0.5, 0.99])
def test_a_truncated_file_is_refused(tmp_path, model, weights, suffix, share):
    path = write(tmp_path / f"weights{suffix}", weights)
    content = path.read_bytes()
    path.write_bytes(content[: int(len(content) * share)])
    assert_refused(path, model, "it is empty" if share == 0 else "truncated")


POINTER = b"version https://git-lfs.github.com/spec/v1\noid sha256:" + b"0" * 64 + b"\nsize 51461264\n"


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_a_git_lfs_pointer_is_called_by_its_name(tmp_path, model, suffix):
    path = tmp_path / f"weights{suffix}"
    path.write_bytes(POINTER)
    assert_refused(path, model, "git-lfs pointer", "git lfs pull")


def safetensors_bytes(header, size=64):
    text = header if isinstance(header, bytes) else json.dumps(header).encode()
    return struct.pack("<Q", len(text)) + text + bytes(size)


GARBAGE = {
    "text": b"not a checkpoint at all\n",
    "zeros": bytes(1000),
    "noise": bytes(range(256)) * 8,
    "html": b"<!DOCTYPE html><html>404</html>",
    "pickle opcodes": b"\x80\x02}q\x00(X",
    "one byte": b"\x80",
    "empty zip": b"PK\x05\x06" + bytes(18),
    "header of no end": struct.pack("<Q", 2**62) + b"{}",
    "header that is no json": safetensors_bytes(b"\xff\xfe{}"),
    "header that is a list": safetensors_bytes(b"[]"),
    "unknown dtype": safetensors_bytes({FIRST: {"dtype": "F99", "shape": [16], "data_offsets": [0, 64]}}),
    "shape that overflows": safetensors_bytes({FIRST: {"dtype": "F32", "shape": [2**62, 8], "data_offsets": [0, 64]}}),
    "shape unlike its bytes": safetensors_bytes({FIRST: {"dtype": "F32", "shape": [9], "data_offsets": [0, 64]}}),
}


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize("content", GARBAGE.values(), ids=GARBAGE)
def test_garbage_is_refused(tmp_path, model, suffix, content):
    path = tmp_path / f"weights{suffix}"
    path.write_bytes(content)
    assert_refused(path, model, f"{len(content)} bytes")


@pytest.mark.parametrize(
    "content",
    [
        [1, 2],
        torch.zeros(3),
        None,
        {1: torch.zeros(3)},
        {FIRST: [1.0, 2.0]},
        {"state_dict": None},
        {"state_dict": [torch.zeros(3)]},
        {"epoch": 3, "model": {FIRST: torch.zeros(3)}},
        "weights",
    ],
    ids=str,
)
def test_a_pickle_that_is_no_state_dict_is_refused(tmp_path, model, content):
    assert_refused(write(tmp_path / "weights.pth", content), model, "dictionary of named tensors", "model.state_dict()")


def test_an_empty_state_dict_is_refused(tmp_path, model):
    assert_refused(write(tmp_path / "weights.pth", {}), model, "missing", FIRST)


@pytest.mark.parametrize(("suffix", "other"), [(".pth", ".safetensors"), (".safetensors", ".pth")])
def test_a_file_of_the_other_kind_under_this_ending_is_refused(tmp_path, model, weights, suffix, other):
    path = write(tmp_path / f"weights{suffix}", weights).rename(tmp_path / f"weights{other}")
    assert_refused(path, model, "of another kind")


def test_a_whole_pickled_module_is_refused(tmp_path, model):
    assert_refused(write(tmp_path / "weights.pth", copy.deepcopy(model)), model, "another kind")


# --- What would run code ------------------------------------------------------------------------------------------


class Gadget:
    """Creates a file when it is unpickled."""

    def __init__(self, sentinel):
        self.sentinel = str(sentinel)

    def __reduce__(self):
        return os.mkdir, (self.sentinel,)


def write_malicious(path, kind, weights, sentinel):
    content = {"state_dict": weights, "optimizer": Gadget(sentinel)}
    if kind == "archive":
        torch.save(content, path)
    elif kind == "legacy":
        torch.save(content, path, _use_new_zipfile_serialization=False)
    else:
        path.write_bytes(pickle.dumps(Gadget(sentinel), protocol=2))


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize("kind", ["bare", "archive", "legacy"])
def test_a_malicious_pickle_is_refused_and_never_runs(tmp_path, model, weights, suffix, kind):
    path, sentinel = tmp_path / f"weights{suffix}", tmp_path / "it ran"
    write_malicious(path, kind, weights, sentinel)
    assert_refused(path, model)
    assert not sentinel.exists()


@pytest.mark.parametrize("kind", ["bare", "archive", "legacy"])
def test_the_malicious_pickle_would_run_if_it_were_trusted(tmp_path, weights, kind):
    """Or the test above would prove nothing."""
    path, sentinel = tmp_path / "weights.pth", tmp_path / "it ran"
    write_malicious(path, kind, weights, sentinel)
    if kind == "bare":
        pickle.loads(path.read_bytes())
    else:
        torch.load(path, weights_only=False)
    assert sentinel.exists()


def test_an_archive_with_a_malicious_pickle_put_in_later_is_refused(tmp_path, model, weights):
    honest, path, sentinel = tmp_path / "honest.pth", tmp_path / "weights.pth", tmp_path / "it ran"
    write(honest, weights)
    with zipfile.ZipFile(honest) as source, zipfile.ZipFile(path, "w") as target:
        for entry in source.infolist():
            evil = entry.filename.endswith("data.pkl")
            target.writestr(entry.filename, pickle.dumps(Gadget(sentinel), protocol=2) if evil else source.read(entry))
    assert_refused(path, model)
    assert not sentinel.exists()


# --- Tensors of kinds that a checkpoint of ours never holds ---------------------------------------------------------

ODD_TENSORS = {
    "float8": lambda t: t.to(torch.float8_e4m3fn),
    "sparse": lambda t: t.to_sparse(),
    "without data": lambda t: t.to("meta"),
    "endless, of one number": lambda t: torch.zeros(1).expand(2**45),
}


@pytest.mark.parametrize("change", ODD_TENSORS.values(), ids=ODD_TENSORS)
def test_a_tensor_of_an_odd_kind_is_refused_by_name(tmp_path, model, weights, change):
    assert_refused(write(tmp_path / "weights.pth", weights | {FIRST: change(weights[FIRST])}), model, FIRST)


def test_float8_in_safetensors_is_refused_by_name(tmp_path, model, weights):
    odd = weights | {FIRST: weights[FIRST].to(torch.float8_e4m3fn)}
    assert_refused(write(tmp_path / "weights.safetensors", odd), model, FIRST)


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_a_double_that_overflows_the_models_float_is_refused_by_name(tmp_path, model, weights, suffix):
    doubles = torch.full(weights[FIRST].shape, 1e300, dtype=torch.float64)
    assert_refused(write(tmp_path / f"weights{suffix}", weights | {FIRST: doubles}), model, "not finite", FIRST)


@pytest.mark.parametrize("dtype", [torch.complex64, torch.bool, torch.int64, torch.uint8])
@pytest.mark.filterwarnings("ignore:Casting complex")
def test_numbers_that_are_not_floating_point_are_refused_by_name(tmp_path, model, weights, dtype):
    odd = weights | {FIRST: torch.ones(weights[FIRST].shape).to(dtype)}
    assert_refused(write(tmp_path / "weights.safetensors", odd), model, FIRST)
