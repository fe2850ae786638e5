"""Nothing in a refused pickle runs to find its weights, and no code is advised if it names a dangerous function."""

import argparse
import os
import pickle

import pytest

from duospacenet.weights.pickle_outline import read_outline
from tests.helpers.checkpoints import (
    refusal,
    write,
)

ARGUMENTS = argparse.Namespace(lr=1e-4)


class Call:
    """An object that calls a function when it is unpickled."""

    def __init__(self, function, *arguments):
        self.call = function, arguments

    def __reduce__(self):
        return self.call


@pytest.mark.parametrize("function", [os.system, os.mkdir, eval, exec, open, getattr])
def test_a_dangerous_function_behind_a_harmless_object_is_not_advised_to_be_run(tmp_path, model, weights, function):
    """The error of torch only names the first object, here the arguments."""
    path = write(tmp_path / "w.pth", {"args": ARGUMENTS, "model": weights, "hook": Call(function, "true")})
    message = refusal(path, model)
    assert "argparse.Namespace" in message
    assert "do not open the file in any other way" in message
    assert "torch.load(" not in message


@pytest.mark.parametrize(
    "gadget",
    [
        Call(os.mkdir, "it ran"),
        [Call(os.mkdir, "it ran"), Call(exec, "import os; os.mkdir('it ran')")],
        {"state_dict": {}, "hook": Call(getattr, "a", "upper")},
    ],
)
def test_an_outline_runs_nothing(tmp_path, monkeypatch, gadget):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "w.pth").write_bytes(pickle.dumps(gadget))
    assert read_outline(tmp_path / "w.pth") is not None
    assert [path.name for path in tmp_path.iterdir()] == ["w.pth"]


@pytest.mark.filterwarnings("ignore:Detected pickle protocol")
@pytest.mark.parametrize(
    "content",
    [
        b"\x80\x05\x96\xff\xff\xff\xff\xff\xff\xff\x3f.",  # a bytearray of 4 exabytes
        b"\x80\x04\x8e\xff\xff\xff\xff\xff\xff\xff\x3f.",  # bytes of 4 exabytes
        b"\x80\x02Nr\xff\xff\xff\x7f.",  # the 2 billionth entry of the memo
        b"\x80\x02\x82\x01.",  # an object of the extension registry
        b"(" * 100_000,
        b"\x80\x02" + b"]" * 100_000 + b"a" * 99_999 + b".",  # nested lists
    ],
)
def test_an_absurd_pickle_is_refused_in_little_memory(tmp_path, model, content):
    (tmp_path / "w.pth").write_bytes(content)
    read_outline(tmp_path / "w.pth")
    assert "w.pth" in refusal(tmp_path / "w.pth", model)
