"""The code in the message about a refused pickle works on that very file."""

import argparse
import collections
from pathlib import PurePosixPath

import numpy as np
import pytest
import torch

from duospacenet.weights import load_checkpoint
from tests.helpers.checkpoints import (
    altered,
    assert_holds,
    prefixed,
    refusal,
    run_python_in,
    small_network,
    write,
)

ARGUMENTS = argparse.Namespace(lr=1e-4)


def as_arrays(weights):
    return {name: tensor.numpy() for name, tensor in weights.items()}


# Files that are refused for an object beside the weights, and as what the weights are then found.
REFUSED = {
    "DETR": lambda w: {"model": w, "args": ARGUMENTS},
    "under state_dict": lambda w: {"state_dict": prefixed("module.", w), "config": PurePosixPath("configs/a.py")},
    "an average beside them": lambda w: {"model": altered(w), "ema": {"shadow": w, "decay": 0.9}, "args": ARGUMENTS},
    "an average in an object": lambda w: {"model": w, "ema": argparse.Namespace(shadow=altered(w))},
    "deep": lambda w: {"run": {"best": {"net": w, "score": np.float64(0.4)}}},
    "a key with quotes and braces": lambda w: {'it\'s {0} "x"': w, "args": ARGUMENTS},
    "a number among the weights": lambda w: w | {"best": np.float64(0.4)},
    "an optimizer with more tensors": lambda w: {
        "net": w,
        "optimizer": {"state": prefixed("a.", w) | prefixed("b.", w)},
        "args": ARGUMENTS,
    },
    "a NumPy number": lambda w: {"epoch": np.int64(4), "state_dict": w},
    "arrays as detectron2 saves them": lambda w: {"model": as_arrays(w), "__author__": "zoo"},
    "a whole module": lambda w: filled(w),
    "a module in a dictionary": lambda w: {"model": filled(w), "epoch": 3},
    "another object as a key": lambda w: {"model": w, "by device": {torch.device("cpu"): 1, PurePosixPath("a"): 2}},
    "a counter": lambda w: {"model": w, "labels": collections.UserDict(a=1)},
}


def filled(weights):
    network = small_network(seed=3)
    network.load_state_dict(weights)
    return network


@pytest.mark.parametrize("legacy", [False, True])
@pytest.mark.parametrize("kind", REFUSED)
def test_the_code_in_the_message_saves_weights_that_load(tmp_path, model, weights, kind, legacy):
    path = tmp_path / "from the zoo.pth"
    torch.save(REFUSED[kind](weights), path, _use_new_zipfile_serialization=not legacy)
    message = refusal(path, model)
    assert "if you trust whoever made it" in message
    load_checkpoint(run_python_in(message, tmp_path), model)
    assert_holds(model, weights)


def test_the_code_works_for_a_pickle_with_the_name_of_safetensors(tmp_path, model, weights):
    path = tmp_path / "w.safetensors"
    torch.save({"model": weights, "args": ARGUMENTS}, path)
    load_checkpoint(run_python_in(refusal(path, model), tmp_path), model)
    assert_holds(model, weights)


def test_without_tensors_the_message_has_no_code(tmp_path, model):
    message = refusal(write(tmp_path / "w.pth", {"model": ARGUMENTS}), model)
    assert "torch.save(" not in message
    assert "Save model.state_dict() with torch.save" in message
