"""RELIABILITY rows A1, A2, A4 and A5: checkpoints that are damaged, malicious, of another model, or not finite."""

import builtins
import copy
import json
import os
import pickle
import random
import re
import struct
import zipfile
from pathlib import Path

import pytest
import torch
from torch import nn

from duospacenet.cli.main import run_app
from duospacenet.export import bundle, export_bundle
from duospacenet.model import PRESETS, DuoSpaceNet, randomise
from duospacenet.model.backbones.resnet import ResNet
from duospacenet.model.config import ResNetConfig
from duospacenet.runtime.errors import ArtifactError
from duospacenet.weights import CheckpointError, load_checkpoint
from duospacenet.weights.checkpoint_layout import recognise_layout
from duospacenet.weights.checkpoint_wrappers import unwrap
from duospacenet.weights.tensor_matching import match_tensors
from tests.helpers.checkpoints import SUFFIXES, assert_holds, assert_refused, in_mmdetection3d_names, write

FIRST = "conv1.weight"  # (8, 3, 7, 7)
BAD_ARTIFACT = 4


@pytest.fixture(scope="module")
def weights():
    return network(seed=1).state_dict()


@pytest.fixture
def model():
    """A small backbone: in its file, a larger share of the bytes describes the tensors."""
    return network(seed=2)


def network(seed):
    torch.manual_seed(seed)
    return ResNet(ResNetConfig("basic", (1, 1, 1, 1), width=8)).eval()


def assert_command_refuses(checkpoint, capfd, *words):
    """`export`, with and without `--dry-run`, ends with 4, these words and no traceback, and writes nothing."""
    folder = checkpoint.parent
    before = sorted(path.name for path in folder.iterdir())
    arguments = ["export", "--preset", "tiny", "--weights", str(checkpoint)]
    for rest in (["--dry-run"], ["--out", str(folder / "bundle")]):
        assert run_app(arguments + rest) == BAD_ARTIFACT
        printed = capfd.readouterr()
        message = " ".join((printed.out + printed.err).split())
        for word in (checkpoint.name, *words):
            assert word in message
        assert "Traceback" not in printed.err
        assert "internal error" not in printed.err
    assert sorted(path.name for path in folder.iterdir()) == before


# --- A1: empty, truncated, garbage, git-lfs pointer ---------------------------------------------------------------


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize("share", [0, 0.01, 0.25, 0.5, 0.99])
def test_a1_a_truncated_checkpoint_is_refused_with_its_size(tmp_path, tiny_model, capfd, suffix, share):
    path = write(tmp_path / f"weights{suffix}", tiny_model.state_dict())
    content = path.read_bytes()[: int(path.stat().st_size * share)]
    path.write_bytes(content)
    assert_refused(path, copy.deepcopy(tiny_model), f"{len(content)} bytes")
    assert_command_refuses(path, capfd, f"{len(content)} bytes", "the file is empty" if share == 0 else "truncated")


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_a1_a_changed_byte_is_refused_or_gives_a_complete_finite_model(tmp_path, model, weights, suffix):
    """200 changes, every other one near the start or the end of the file, which hold no numbers.

    A file with a changed number may load, because only a sha256 can detect that.
    """
    path = write(tmp_path / f"weights{suffix}", weights)
    original, rng, num_refused = path.read_bytes(), random.Random(0), 0
    for change in range(200):
        content = bytearray(original)
        offset = rng.randrange(len(content)) if change % 2 else rng.randrange(-2000, 2000)
        content[offset] ^= rng.randrange(1, 256)
        path.write_bytes(content)
        try:
            report = load_checkpoint(path, model)
        except CheckpointError as error:
            assert path.name in str(error)
            num_refused += 1
        else:
            assert report.matched.keys() == weights.keys()
            assert all(tensor.isfinite().all() for tensor in model.state_dict().values())
    assert 20 < num_refused < 200


POINTER = b"version https://git-lfs.github.com/spec/v1\noid sha256:" + b"0" * 64 + b"\nsize 51461264\n"


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_a1_a_git_lfs_pointer_is_reported_as_such(tmp_path, capfd, suffix):
    path = tmp_path / f"weights{suffix}"
    path.write_bytes(POINTER)
    assert_command_refuses(path, capfd, f"{len(POINTER)} bytes", "git-lfs pointer", "git lfs pull")


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
    "endless header": struct.pack("<Q", 2**62) + b"{}",
    "header is not JSON": safetensors_bytes(b"\xff\xfe{}"),
    "header is a list": safetensors_bytes(b"[]"),
    "unknown dtype": safetensors_bytes({FIRST: {"dtype": "F99", "shape": [16], "data_offsets": [0, 64]}}),
    "shape overflows": safetensors_bytes({FIRST: {"dtype": "F32", "shape": [2**62, 8], "data_offsets": [0, 64]}}),
    "shape does not fit the bytes": safetensors_bytes({FIRST: {"dtype": "F32", "shape": [9], "data_offsets": [0, 64]}}),
}


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize("content", GARBAGE.values(), ids=GARBAGE)
def test_a1_garbage_is_refused_with_its_size_and_likely_cause(tmp_path, model, suffix, content):
    path = tmp_path / f"weights{suffix}"
    path.write_bytes(content)
    assert_refused(path, model, f"{len(content)} bytes", "web page" if b"html" in content else "of another kind")


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
        {"epoch": 3, "weights": {"shapes": [3]}},
        [{"epoch": 3}, [torch.zeros(3)]],
        "weights",
    ],
    ids=str,
)
def test_a1_a_pickle_without_a_state_dict_is_refused(tmp_path, model, content):
    assert_refused(write(tmp_path / "weights.pth", content), model, "dictionary of named tensors", "model.state_dict()")


@pytest.mark.parametrize(("suffix", "other"), [(".pth", ".safetensors"), (".safetensors", ".pth")])
def test_a1_a_file_with_the_suffix_of_the_other_format_is_read_by_its_content(tmp_path, model, weights, suffix, other):
    path = write(tmp_path / f"weights{suffix}", weights).rename(tmp_path / f"weights{other}")
    load_checkpoint(path, model)
    assert_holds(model, weights)


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_a1_a_missing_file_and_a_folder_are_reported_as_such(tmp_path, model, capfd, suffix):
    for path, got in ((tmp_path / f"weights{suffix}", "no such file"), (tmp_path, "a folder")):
        assert_refused(path, model, got, error=FileNotFoundError)
    assert_command_refuses(tmp_path / f"weights{suffix}", capfd, "no such file")


def test_a1_an_archive_that_unpacks_to_far_more_than_its_size_is_refused(tmp_path, model, monkeypatch):
    monkeypatch.setattr("duospacenet.weights.checkpoint_file._MAX_UNPACKED_BYTES", 10**6)
    plain, packed = write(tmp_path / "plain.pth", {FIRST: torch.zeros(10**6)}), tmp_path / "packed.pth"
    with zipfile.ZipFile(plain) as source, zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as target:
        for entry in source.infolist():
            target.writestr(entry.filename, source.read(entry))
    assert packed.stat().st_size < 10**5
    assert_refused(packed, model, "not compressed", "bytes that unpack to 40")
    assert_refused(plain, model, "mis-shaped")


def test_a1_a_name_that_is_not_utf_8_is_no_obstacle(tmp_path, model, weights):
    for suffix in SUFFIXES:
        path = write(tmp_path / f"weights{suffix}", weights)
        load_checkpoint(path.rename(tmp_path / os.fsdecode(b"\xff\xfe" + suffix.encode())), model)
        assert_holds(model, weights)


# --- A2: files that would run code -------------------------------------------------------------------------------


class Call:
    """An object that calls a function when it is unpickled."""

    def __init__(self, function, *arguments):
        self.call = function, arguments

    def __reduce__(self):
        return self.call


class MakesFolder:
    """An object that makes a folder when its state is restored."""

    def __init__(self, sentinel):
        self.sentinel = sentinel

    def __setstate__(self, state):
        Path(state["sentinel"]).mkdir()


class ModuleThatMakesFolder(nn.Linear):
    """A module, as `torch.save(model)` writes it, that makes a folder when its state is restored."""

    def __init__(self, sentinel):
        super().__init__(2, 2)
        self.sentinel = sentinel

    def __setstate__(self, state):
        super().__setstate__(state)
        Path(state["sentinel"]).mkdir()


def nested(sentinel):
    """An object that unpickles another file without restrictions."""
    inner = Path(sentinel).with_name("inner.bin")
    inner.write_bytes(pickle.dumps(Call(os.mkdir, sentinel)))
    return Call(pickle.loads, inner.read_bytes())


GADGETS = {
    "os.system": (lambda sentinel: Call(os.system, f"mkdir '{sentinel}'"), "posix.system"),
    "eval": (lambda sentinel: Call(builtins.eval, f"__import__('os').mkdir({sentinel!r})"), "ask for eval"),
    "exec": (lambda sentinel: Call(builtins.exec, f"import os; os.mkdir({sentinel!r})"), "ask for exec"),
    "nested load": (nested, "pickle.loads"),
    "__setstate__": (MakesFolder, "MakesFolder"),
    "whole module": (ModuleThatMakesFolder, "ModuleThatMakesFolder"),
}
PACKINGS = ["archive", "legacy", "bare"]


def write_gadget(path, gadget, packing, weights):
    """Save the gadget beside valid weights with torch, or alone as a bare pickle."""
    content = {"state_dict": weights, "optimizer": gadget}
    if packing == "bare":
        path.write_bytes(pickle.dumps(gadget, protocol=2))
    else:
        torch.save(content, path, _use_new_zipfile_serialization=packing == "archive")


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize("packing", PACKINGS)
@pytest.mark.parametrize("kind", GADGETS)
def test_a2_a_malicious_pickle_is_refused_and_never_runs(tmp_path, weights, capfd, suffix, packing, kind):
    path, sentinel = tmp_path / f"weights{suffix}", tmp_path / "it ran"
    make, name = GADGETS[kind]
    write_gadget(path, make(str(sentinel)), packing, weights)
    assert_command_refuses(path, capfd, name)
    assert not sentinel.exists()


@pytest.mark.parametrize("packing", PACKINGS)
@pytest.mark.parametrize("kind", GADGETS)
def test_a2_a_trusted_malicious_pickle_would_run(tmp_path, weights, packing, kind):
    """Otherwise the test above would prove nothing."""
    path, sentinel = tmp_path / "weights.pth", tmp_path / "it ran"
    write_gadget(path, GADGETS[kind][0](str(sentinel)), packing, weights)
    if packing == "bare":
        pickle.loads(path.read_bytes())
    else:
        torch.load(path, weights_only=False)
    assert sentinel.exists()


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("protocol", range(pickle.HIGHEST_PROTOCOL + 1))
def test_a2_a_plain_pickle_of_any_protocol_is_refused_by_the_name_of_its_function(tmp_path, model, protocol):
    path, sentinel = tmp_path / "weights.pkl", tmp_path / "ran"
    content = {"state_dict": _Call(os.system, (f"touch {sentinel}",))}
    path.write_bytes(pickle.dumps(content, protocol=protocol))
    with pytest.raises(CheckpointError, match=r"system, which could run code\. Weights never need it"):
        load_checkpoint(path, model)
    assert not sentinel.exists()


def test_a2_an_archive_whose_pickle_was_replaced_is_refused(tmp_path, weights, capfd):
    honest, path, sentinel = tmp_path / "honest.pth", tmp_path / "weights.pth", tmp_path / "it ran"
    write(honest, weights)
    evil = pickle.dumps(Call(os.mkdir, str(sentinel)), protocol=2)
    with zipfile.ZipFile(honest) as source, zipfile.ZipFile(path, "w") as target:
        for entry in source.infolist():
            target.writestr(entry.filename, evil if entry.filename.endswith("data.pkl") else source.read(entry))
    assert_command_refuses(path, capfd, ".mkdir")
    assert not sentinel.exists()


class HistoryBuffer:
    """Like mmengine's class, which its runner saves in a checkpoint's `message_hub`."""


def test_a2_a_class_of_a_training_framework_is_named_with_advice_to_save_only_the_tensors(tmp_path, model, weights):
    path = write(tmp_path / "epoch_24.pth", {"state_dict": weights, "message_hub": {"loss": HistoryBuffer()}})
    assert_refused(path, model, f"{__name__}.HistoryBuffer", "if you trust whoever made it", "save the tensors alone")


@pytest.mark.parametrize("function", [os.system, eval, exec, open])
def test_a2_for_a_function_that_no_weights_need_the_advice_is_not_to_open_the_file(tmp_path, model, weights, function):
    path = write(tmp_path / "weights.pth", {"state_dict": weights, "hook": Call(function, "true")})
    assert_refused(path, model, function.__name__, "do not open the file in any other way")


# --- A4: missing, unexpected, mis-shaped --------------------------------------------------------------------------


def faults_of(tensors, model):
    """The faults of these tensors for a model, by kind. The tensors are refused exactly if there is a fault.

    The tensors are not written to a file, because a test of each of them would take too long.
    """
    expected = model.state_dict()
    source = unwrap(tensors, expected)
    report = match_tensors(source, recognise_layout(source.tensors, expected), expected)
    faults = {kind: names for kind, names in report.faults.items() if names}
    assert report.accepted == (not faults)
    return faults


def test_a4_the_models_own_tensors_have_no_fault(tiny_model):
    """Otherwise the tests below would prove nothing."""
    assert faults_of(tiny_model.state_dict(), tiny_model) == {}


def test_a4_every_missing_tensor_is_named(tiny_model):
    tensors = tiny_model.state_dict()
    needed = [name for name in tensors if not name.endswith("num_batches_tracked")]
    assert len(needed) > 250
    for name in needed:
        rest = {key: tensor for key, tensor in tensors.items() if key != name}
        assert faults_of(rest, tiny_model) == {"missing": [name]}


def test_a4_every_renamed_tensor_is_reported_by_both_names(tiny_model):
    tensors = tiny_model.state_dict()
    for name in tensors:
        renamed = {f"{key}_" if key == name else key: tensor for key, tensor in tensors.items()}
        counted = {} if name.endswith("num_batches_tracked") else {"missing": [name]}
        assert faults_of(renamed, tiny_model) == counted | {"unexpected": [f"{name}_"]}


def test_a4_every_reshaped_tensor_is_reported_with_both_shapes(tiny_model):
    """The last axis is one longer; a scalar gets an axis."""
    tensors = tiny_model.state_dict()
    for name in tensors:
        shape = tuple(tensors[name].shape)
        longer = torch.zeros((*shape[:-1], shape[-1] + 1) if shape else (1,), dtype=tensors[name].dtype)
        fault = f"{name} (expected {shape}, got {tuple(longer.shape)})"
        assert faults_of(tensors | {name: longer}, tiny_model) == {"mis-shaped": [fault]}


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize("shape", [(8, 3, 7, 6), (3, 8, 7, 7), (1, 3, 7, 7), (1176,), (), (0,), (1, 8, 3, 7, 7)])
def test_a4_a_misshapen_tensor_is_refused_with_both_shapes(tmp_path, model, weights, suffix, shape):
    """Also a shape that would broadcast, or that has the same number of elements."""
    path = write(tmp_path / f"weights{suffix}", weights | {FIRST: torch.zeros(shape)})
    assert_refused(path, model, "1 mis-shaped", FIRST, "expected (8, 3, 7, 7)", f"got {shape}")


CHANGES = {
    "missing": (lambda w: w.pop("queries.pose"), "1 missing: queries.pose"),
    "unexpected": (lambda w: w.update({"depth_head.weight": torch.zeros(3)}), "1 unexpected: depth_head.weight"),
    "mis-shaped": (
        lambda w: w.update({"lifter.reduction.weight": torch.zeros(3)}),
        "lifter.reduction.weight (expected",
    ),
}


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize("change", CHANGES)
def test_a4_the_command_names_the_tensor(tmp_path, tiny_model, capfd, suffix, change):
    tensors = dict(tiny_model.state_dict())
    edit, words = CHANGES[change]
    edit(tensors)
    assert_command_refuses(write(tmp_path / f"weights{suffix}", tensors), capfd, words)


def test_a4_every_tensor_of_a_foreign_backbone_and_neck_is_required(tiny_model):
    """The other parts of the model are missing in this layout, but each tensor of these two parts is required."""
    named = in_mmdetection3d_names(tiny_model.state_dict())
    other_parts = faults_of(named, tiny_model)["missing"]
    assert not [name for name in other_parts if name.startswith("image_encoder.")]
    for name in named:
        if not name.endswith("num_batches_tracked"):
            rest = {key: tensor for key, tensor in named.items() if key != name}
            assert len(faults_of(rest, tiny_model)["missing"]) == len(other_parts) + 1


def test_a4_all_faults_are_reported_at_once_and_long_lists_are_shortened(tmp_path, model, weights):
    """layer2 has 3 convolutions, and 3 norms of 4 tensors: 15 tensors are missing."""
    kept = {name: tensor for name, tensor in weights.items() if not name.startswith("layer2.")}
    path = write(tmp_path / "weights.pth", kept | {"extra": torch.full((1,), torch.nan), FIRST: torch.zeros(2)})
    assert_refused(path, model, "15 missing", "and 10 more", "1 unexpected: extra", "1 mis-shaped")


# --- A5: NaN and Inf ----------------------------------------------------------------------------------------------

KINDS = {
    "convolution": "image_encoder.backbone.conv1.weight",
    "convolution's bias": "image_encoder.neck.extra.bias",
    "convolution in three dimensions": "divergence_enhancement.conv3d.0.0.weight",
    "norm's scale": "image_encoder.backbone.layer4.0.bn2.weight",
    "norm's shift": "image_encoder.backbone.layer4.0.bn2.bias",
    "running mean": "divergence_enhancement.conv2d.2.1.running_mean",
    "running variance": "segmentation.enter.1.running_var",
    "linear layer": "decoder.layers.1.feedforward.2.weight",
    "linear layer's bias": "decoder.layers.0.heads.classes.3.bias",
    "layer norm": "decoder.layers.1.cross_attention.bev.norm.weight",
    "poses": "queries.pose",
    "content": "queries.content",
}
NUMBERS = {"NaN": float("nan"), "Inf": float("inf"), "-Inf": -float("inf")}


@pytest.mark.parametrize("number", NUMBERS)
@pytest.mark.parametrize("kind", KINDS)
def test_a5_a_checkpoint_with_one_nonfinite_number_is_refused_by_name(tmp_path, tiny_model, number, kind):
    tensors = {name: tensor.clone() for name, tensor in tiny_model.state_dict().items()}
    tensors[KINDS[kind]].view(-1)[-1] = NUMBERS[number]
    path = write(tmp_path / "weights.safetensors", tensors)
    assert_refused(path, randomise(DuoSpaceNet(PRESETS["tiny"])), f"1 not finite: {KINDS[kind]}")


def test_a5_the_command_names_the_tensor(tmp_path, tiny_model, capfd):
    tensors = tiny_model.state_dict() | {"queries.pose": torch.full((32, 10), torch.inf)}
    assert_command_refuses(write(tmp_path / "weights.pth", tensors), capfd, "1 not finite: queries.pose")


@pytest.mark.parametrize("number", NUMBERS)
def test_a5_a_model_in_memory_with_one_nonfinite_number_is_refused_before_tracing(
    tmp_path, tiny_model, monkeypatch, number
):
    """One number in one parameter or buffer of every kind, persistent or not."""
    monkeypatch.setattr(bundle, "graphs_to_export", lambda _: pytest.fail("the export continued"))
    model = copy.deepcopy(tiny_model)
    for name, tensor in one_tensor_of_each_kind(model).items():
        numbers = tensor.data.view(-1)
        original = numbers[-1].clone()
        numbers[-1] = NUMBERS[number]
        with pytest.raises(ArtifactError, match=re.escape(f"1 tensors, the first {name}.")) as refusal:
            export_bundle(model, tmp_path / "bundle")
        numbers[-1] = original
        assert refusal.value.exit_code == BAD_ARTIFACT
    assert list(tmp_path.iterdir()) == []


def one_tensor_of_each_kind(model):
    """One tensor for each pair of module type and attribute name, by its full name."""
    kinds = {}
    for name, tensor in [*model.named_parameters(), *model.named_buffers()]:
        if tensor.is_floating_point():
            module, _, leaf = name.rpartition(".")
            kinds[type(model.get_submodule(module)), leaf] = name, tensor
    assert len(kinds) > len(KINDS)
    return dict(kinds.values())


class _Call:
    """Its pickle calls a function when it is loaded."""

    def __init__(self, function, arguments) -> None:
        self._call = function, arguments

    def __reduce__(self):
        return self._call
