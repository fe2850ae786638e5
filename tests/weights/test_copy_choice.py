"""Of several copies of the weights, the right one is used. A choice that is not clear is refused."""

import pytest
import torch

from duospacenet.weights import CheckpointError, load_checkpoint, read_checkpoint
from tests.helpers.checkpoints import altered, assert_holds, assert_refused, prefixed, write

AMBIGUOUS = {
    "student and teacher": (lambda w: {"student": altered(w), "teacher": w}, "teacher"),
    "prefixes": (
        lambda w: {"state_dict": prefixed("student.", altered(w)) | prefixed("teacher.", w)},
        "state_dict.teacher",
    ),
    "two averages": (lambda w: {"model": altered(w), "ema": {"0.99": w, "0.999": altered(w)}}, "ema.0.99"),
    "a best copy": (lambda w: {"model": altered(w), "best": {"state_dict": w}}, "best"),
    "a list": (lambda w: [altered(w), w], "1"),
    "two usual keys": (lambda w: {"model": altered(w), "state_dict": w}, "state_dict"),
}


@pytest.mark.parametrize("kind", AMBIGUOUS)
def test_copies_without_a_clear_choice_are_refused_and_a_key_chooses(tmp_path, model, weights, kind):
    make, key = AMBIGUOUS[kind]
    path = write(tmp_path / "weights.pth", make(weights))
    message = assert_refused(path, model, "expected one copy of the weights; got 2", key)
    advised = message.rpartition("--weights-key ")[2].removesuffix(".")
    read_checkpoint(path, model, weights_key=advised)
    report = load_checkpoint(path, model, weights_key=key)
    assert_holds(model, weights)
    assert ".".join(report.wrappers).startswith(key)
    assert len(report.left_aside) >= len(weights)


def test_a_key_chooses_the_raw_weights(tmp_path, model, weights):
    path = write(tmp_path / "weights.pth", {"model": prefixed("module.", weights), "model_ema": altered(weights)})
    load_checkpoint(path, model, weights_key="model")
    assert_holds(model, weights)


@pytest.mark.parametrize("key", ["teacher", "mode", "model.conv1.weight", "optimizer", ""])
def test_a_key_without_tensors_is_refused_with_the_keys_of_the_file(tmp_path, model, weights, key):
    path = write(tmp_path / "weights.pth", {"model": weights, "optimizer": {"a": torch.zeros(3)}})
    with pytest.raises(CheckpointError, match="expected a key with tensors; the file has model"):
        load_checkpoint(path, model, weights_key=key)


def test_equal_copies_need_no_choice(tmp_path, model, weights):
    path = write(tmp_path / "weights.pth", {"student": weights, "teacher": {n: t.clone() for n, t in weights.items()}})
    report = load_checkpoint(path, model)
    assert_holds(model, weights)
    assert report.notes == ("the file holds several copies of the weights: used student; ignored teacher",)


def test_a_prefix_that_only_a_part_of_the_model_has_is_not_a_wrapper(tmp_path, model, weights):
    named = {f"module.{name}" if name.startswith("layer4.") else name: tensor for name, tensor in weights.items()}
    assert_refused(
        write(tmp_path / "weights.pth", named), model, "got 2: the top level, module", "--weights-key module"
    )
