"""All tensors of nested dictionaries are found by their path, also in dictionaries that are meant to be endless."""

import pytest
import torch

from duospacenet.weights.flat_checkpoint import UnwrapError, flatten_checkpoint
from tests.helpers.checkpoints import assert_refused, write

A, B = torch.zeros(1), torch.ones(1)


def test_keys_and_indices_become_the_path():
    content = {"a": {"b.c": A, "list": [{"d": B}, 3]}, "tuple": ({"e": A},), "number": 3, "none": None, "f": B}
    assert flatten_checkpoint(content).tensors == {"a.b.c": A, "a.list.0.d": B, "tuple.0.e": A, "f": B}


def test_tensors_without_names_are_listed_by_their_place():
    flat = flatten_checkpoint({"ema": {"shadow_params": [A, B]}, "odd": {3: A}})
    assert flat == ({}, ("ema.shadow_params", "odd"))


@pytest.mark.parametrize("key", ["optimizer", "optimizer_states", "lr_schedulers"])
def test_the_state_of_a_training_is_left_out(key):
    assert flatten_checkpoint({key: {"state": {"a.weight": A}}, "run": [{key: [{"b": B}]}], "c": A}).tensors == {"c": A}


@pytest.mark.parametrize(
    "content",
    [{"a": {"b": A}, "a.b": B}, {"layer._orig_mod.w": A, "layer.w": B}, {1: {"a": A}, "1": {"a": B}}],
)
def test_two_tensors_of_the_same_name_are_refused(content):
    with pytest.raises(UnwrapError, match=r"expected one tensor .*; got two"):
        flatten_checkpoint(content)


def endless():
    """Each level holds the next twelve times: 12^12 paths."""
    content = {}
    for _ in range(40):
        content = {str(index): content for index in range(12)}
    return content


def endless_tensors():
    content = {"w": A}
    for _ in range(40):
        content = {str(index): content for index in range(12)}
    return content


def in_itself():
    content = {"w": A}
    content["model"] = content["state_dict"] = content
    return content


def test_dictionaries_that_share_their_content_take_little_time():
    assert flatten_checkpoint(endless()).tensors == {}
    assert flatten_checkpoint(in_itself()).tensors == {"w": A}
    assert flatten_checkpoint(endless_tensors()).tensors == {}  # they are too deep


def test_too_many_tensors_are_refused(monkeypatch):
    monkeypatch.setattr("duospacenet.weights.flat_checkpoint._MAX_ENTRIES", 1000)
    content = {"w": A}
    for _ in range(8):
        content = {str(index): content for index in range(12)}
    with pytest.raises(UnwrapError, match="expected at most 1000 tensors"):
        flatten_checkpoint(content)


@pytest.mark.parametrize("name", ["\x1b[2Jconv", "two\nlines", "\ud800", "bell\x07.weight", "\u202eright to left"])
def test_a_name_with_control_characters_is_shown_with_escapes(tmp_path, model, weights, name):
    message = assert_refused(write(tmp_path / "w.pth", weights | {name: A}), model, "1 unexpected")
    assert message.isprintable()


def test_a_very_long_name_takes_little_time(tmp_path, model, weights):
    assert_refused(write(tmp_path / "w.pth", weights | {"a." * 500_000: A}), model, "1 unexpected")
