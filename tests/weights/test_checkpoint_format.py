"""Files are read by their content, whatever their name. Other kinds of files are named, with a way out that works."""

import gzip
import io
import json
import re
import subprocess
import tarfile
import zipfile

import numpy as np
import onnx
import pytest
import torch
from onnx import TensorProto, helper
from safetensors.torch import save

from duospacenet.weights import load_checkpoint
from tests.helpers.checkpoints import assert_holds, assert_refused, refusal, run_python_in


def pickled(tensors, legacy=False):
    stream = io.BytesIO()
    torch.save(tensors, stream, _use_new_zipfile_serialization=not legacy)
    return stream.getvalue()


READABLE = {
    "safetensors": save,
    "zip archive": pickled,
    "legacy": lambda tensors: pickled(tensors, legacy=True),
}


@pytest.mark.parametrize(
    "name", ["w.SAFETENSORS", "w.safetensors", "w.pth", "w.pth.tar", "w.bin", "w.ckpt", "w", "w.h5"]
)
@pytest.mark.parametrize("kind", READABLE)
def test_the_content_decides_how_a_file_is_read(tmp_path, model, weights, kind, name):
    (tmp_path / name).write_bytes(READABLE[kind](weights))
    load_checkpoint(tmp_path / name, model)
    assert_holds(model, weights)


def onnx_model():
    value = helper.make_tensor_value_info("x", TensorProto.FLOAT, [1])
    graph = helper.make_graph([helper.make_node("Identity", ["x"], ["y"])], "g", [value], [value])
    return helper.make_model(graph, producer_name="pytorch")


def onnx_without_producer():
    model = onnx_model()
    model.ClearField("producer_name")
    return model.SerializeToString()


def zipped(files):
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        for name, content in files.items():
            archive.writestr(name, content)
    return stream.getvalue()


def tarred(files):
    stream = io.BytesIO()
    with tarfile.open(fileobj=stream, mode="w") as archive:
        for name, content in files.items():
            info = tarfile.TarInfo(name)
            info.size = len(content)
            archive.addfile(info, io.BytesIO(content))
    return stream.getvalue()


def numpy_array():
    stream = io.BytesIO()
    np.save(stream, np.ones(3))
    return stream.getvalue()


OTHER_KINDS = {
    "ONNX": (lambda: onnx_model().SerializeToString(), "an ONNX model"),
    "ONNX without a producer": (onnx_without_producer, "an ONNX model"),
    "HDF5": (lambda: b"\x89HDF\r\n\x1a\n" + bytes(100), "an HDF5 file, as Keras"),
    "NumPy": (numpy_array, "a single NumPy array"),
    "GGUF": (lambda: b"GGUF" + bytes(100), "a GGUF file"),
    "TensorFlow": (lambda: b"\x08\x01\x12\x05\x0a\x03\x22\x01\x31", "a TensorFlow SavedModel"),
    "TensorFlow Lite": (lambda: b"\x1c\x00\x00\x00TFL3" + bytes(64), "a TensorFlow Lite model"),
    "gzip": (lambda: gzip.compress(b"anything"), "gunzip -c"),
    "tar": (lambda: tarred({"w.pth": b"anything"}), "tar -xf"),
    "zip": (lambda: zipped({"w.pth": b"anything", "readme{}.txt": b""}), "a zip archive of other files (w.pth, readme"),
    "web page": (lambda: b"\n<!DOCTYPE html><html>404</html>", "a web page; download the checkpoint itself"),
    "web page without a type": (lambda: b"<HTML><head>", "a web page"),
    "error of a server": (lambda: b'<?xml version="1.0"?><Error><Code>AccessDenied</Code></Error>', "an XML text"),
    "git-lfs pointer": (lambda: b"version https://git-lfs.github.com/spec/v1\noid", "git lfs pull"),
    "JSON": (lambda: json.dumps({"error": "not found"}).encode(), "a JSON text"),
    "JSON list": (lambda: b'[\n  {"a": 1}\n]', "a JSON text"),
    "image": (lambda: b"\x89PNG\r\n\x1a\n" + bytes(64), "an image"),
    "nothing": (lambda: b"", "the file is empty"),
}


@pytest.mark.parametrize("name", ["w.pth", "w.safetensors", "model.safetensors.index.json"])
@pytest.mark.parametrize("kind", OTHER_KINDS)
def test_another_kind_of_file_is_named_as_what_it_is(tmp_path, model, kind, name):
    make, words = OTHER_KINDS[kind]
    (tmp_path / name).write_bytes(make())
    assert_refused(tmp_path / name, model, words, f"{len(make())} bytes")


# --- The advice is followed -----------------------------------------------------------------------------------------


@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::torch.jit.TracerWarning")
def test_the_advice_for_a_torchscript_archive_works(tmp_path, model, weights):
    model.load_state_dict(weights)
    scripted = torch.jit.trace(model, torch.zeros(1, 3, 64, 64))
    path = tmp_path / "it's.pth"
    torch.jit.save(scripted, path)
    message = refusal(path, model)
    assert "a TorchScript archive" in message
    load_checkpoint(run_python_in(message, tmp_path), model)
    assert_holds(model, weights)


def test_the_advice_for_an_exported_program_works(tmp_path, model):
    program = torch.export.export(torch.nn.Linear(2, 3), (torch.zeros(1, 2),))
    torch.export.save(program, tmp_path / "w.pt2")
    message = refusal(tmp_path / "w.pt2", model)
    assert "an exported program" in message
    assert torch.load(run_python_in(message, tmp_path)).keys() == {"weight", "bias"}


def test_the_advice_for_an_archive_of_numpy_arrays_works(tmp_path, model, weights):
    np.savez(tmp_path / "w.npz", **{name: tensor.numpy() for name, tensor in weights.items()})
    message = refusal(tmp_path / "w.npz", model)
    assert "an archive of NumPy arrays" in message
    load_checkpoint(run_python_in(message, tmp_path), model)
    assert_holds(model, weights)


def test_the_advice_for_a_compressed_file_works(tmp_path, model, weights):
    path = tmp_path / "my weights.pth.gz"
    path.write_bytes(gzip.compress(pickled(weights)))
    command = re.search(r"`(gunzip .*)`", refusal(path, model))[1]
    subprocess.run(command, shell=True, check=True, cwd=tmp_path)
    load_checkpoint(tmp_path / "unpacked.pth", model)
    assert_holds(model, weights)


def test_the_advice_for_a_tar_archive_works(tmp_path, model, weights):
    path = tmp_path / "my weights.tar"
    path.write_bytes(tarred({"inner.pth": pickled(weights)}))
    command = re.search(r"`(tar .*)`", refusal(path, model))[1]
    subprocess.run(command, shell=True, check=True, cwd=tmp_path)
    load_checkpoint(tmp_path / "inner.pth", model)
    assert_holds(model, weights)


def test_the_onnx_file_of_the_tests_is_valid():
    onnx.checker.check_model(onnx_model(), full_check=False)
