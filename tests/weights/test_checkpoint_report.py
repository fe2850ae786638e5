"""The report names each tensor that is missing, unexpected or wrong."""

import pytest
import torch

from duospacenet.weights import CheckpointError, load_checkpoint, read_checkpoint
from tests.helpers.checkpoints import FIRST, SUFFIXES, assert_refused, write

# --- Missing tensors ----------------------------------------------------------------------------------------------


def test_a_pattern_allows_missing_tensors_and_no_other_fault(tmp_path, model, weights):
    path = write(tmp_path / "weights.pth", weights | {FIRST: torch.zeros(2), "other": torch.zeros(2)})
    report = read_checkpoint(path, model, ["*"]).report
    assert not report.accepted
    assert [len(tensors) for tensors in report.faults.values()] == [0, 1, 1, 0, 0]


def test_the_error_of_a_refusal_has_the_report(tmp_path, model, weights):
    path = write(tmp_path / "weights.pth", weights | {"other": torch.zeros(2)})
    with pytest.raises(CheckpointError) as refusal:
        load_checkpoint(path, model)
    assert refusal.value.report == read_checkpoint(path, model).report
    assert refusal.value.report.unexpected == ("other",)


def test_a_pattern_without_a_missing_tensor_is_noted(tmp_path, model, weights):
    report = load_checkpoint(write(tmp_path / "weights.pth", weights), model, ["layer9.*"])
    assert report.notes == ("the --allow-missing pattern layer9.* matches no missing tensor",)


@pytest.mark.parametrize("tensors", [{}, {"backbone.conv1.weight": torch.zeros(3)}], ids=["empty", "unknown names"])
def test_a_file_without_any_matching_tensor_is_refused_even_if_all_may_be_missing(tmp_path, model, tensors):
    report = read_checkpoint(write(tmp_path / "weights.pth", tensors), model, ["*"]).report
    assert not report.accepted
    for supported in (
        "this toolkit's own names",
        "torchvision's ResNet",
        "detectron2's VoVNet",
        "mmdetection3d's img_",
    ):
        assert supported in report.verdict


# --- Tensors of unusual types -------------------------------------------------------------------------------------

UNUSUAL_TENSORS = {
    "float8": lambda t: t.to(torch.float8_e4m3fn),
    "sparse": lambda t: t.to_sparse(),
    "without data": lambda t: t.to("meta"),
    "huge, with the memory of one number": lambda t: torch.zeros(1).expand(2**45),
}


@pytest.mark.parametrize("change", UNUSUAL_TENSORS.values(), ids=UNUSUAL_TENSORS)
def test_a_tensor_of_an_unusual_type_is_refused_by_name(tmp_path, model, weights, change):
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
def test_a_dtype_that_is_not_a_float_is_refused_by_name(tmp_path, model, weights, dtype):
    odd = weights | {FIRST: torch.ones(weights[FIRST].shape).to(dtype)}
    assert_refused(write(tmp_path / "weights.safetensors", odd), model, FIRST)
