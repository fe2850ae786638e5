"""The weights are found inside the dictionaries and prefixes of other trainers, and the right copy is used."""

import pytest
import torch

from duospacenet.weights import load_checkpoint
from tests.helpers.checkpoints import altered, assert_holds, assert_refused, prefixed, write

WRAPPED = {
    "state_dict": lambda w: {"state_dict": w, "epoch": 3},
    "model": lambda w: {"model": w, "optimizer": {"lr": 0.1}},
    "model_state_dict": lambda w: {"model_state_dict": w},
    "DataParallel": lambda w: prefixed("module.", w),
    "Lightning": lambda w: {"state_dict": prefixed("model.", w), "global_step": 9},
    "Lightning and DataParallel": lambda w: {"state_dict": prefixed("model.module.", w)},
    "torch.compile": lambda w: prefixed("_orig_mod.", w),
    "torch AveragedModel": lambda w: prefixed("module.", w) | {"n_averaged": torch.tensor(5)},
    "timm": lambda w: {"state_dict": altered(w), "state_dict_ema": w},
    "torchvision references": lambda w: {
        "model": altered(w),
        "model_ema": prefixed("module.", w) | {"n_averaged": torch.tensor(5)},
    },
    "RT-DETR": lambda w: {"model": altered(w), "ema": {"module": w, "updates": 7}},
    "mmengine": lambda w: {
        "state_dict": w,
        "ema_state_dict": prefixed("module.", altered(w)) | {"steps": torch.tensor(7)},
        "meta": {"epoch": 24},
    },
    "mmcv EMAHook": lambda w: {"state_dict": w | mmcv_ema_buffers(w), "meta": {"epoch": 24}},
    "Lightning with a model beside its average": lambda w: {
        "state_dict": prefixed("model.", altered(w)) | prefixed("ema_model.module.", w)
    },
}
WRAPPERS = {
    "mmengine": ("state_dict",),
    "timm": ("state_dict_ema",),
    "torchvision references": ("model_ema", "module"),
    "RT-DETR": ("ema", "module"),
    "mmcv EMAHook": ("state_dict",),
    "Lightning with a model beside its average": ("state_dict", "ema_model", "module"),
}


def mmcv_ema_buffers(tensors):
    """The buffers of mmcv's EMAHook, one for each parameter."""
    statistics = ("running_mean", "running_var", "num_batches_tracked")
    parameters = {name: tensor for name, tensor in tensors.items() if not name.endswith(statistics)}
    return {"ema_" + name.replace(".", "_"): tensor for name, tensor in altered(parameters).items()}


@pytest.mark.parametrize("trainer", WRAPPED)
def test_the_weights_to_deploy_are_found_in_the_files_of_other_trainers(tmp_path, model, weights, trainer):
    path = write(tmp_path / "weights.pth", WRAPPED[trainer](weights))
    report = load_checkpoint(path, model)
    assert_holds(model, weights)
    assert report.wrappers == WRAPPERS.get(trainer, report.wrappers)


@pytest.mark.parametrize(
    ("trainer", "words", "unused_name"),
    [
        ("timm", "used state_dict_ema; ignored state_dict", "state_dict.conv1.weight"),
        (
            "mmengine",
            "used state_dict (the average: mmengine swaps it with the raw weights before it saves); ignored ema_state",
            "ema_state_dict.module.conv1.weight",
        ),
        ("mmcv EMAHook", "used the plain names", "state_dict.ema_conv1_weight"),
        ("RT-DETR", "used ema.module; ignored model", "model.conv1.weight"),
        (
            "Lightning with a model beside its average",
            "used state_dict.ema_model.module; ignored state_dict.model",
            "state_dict.model.conv1.weight",
        ),
    ],
)
def test_the_report_says_which_copy_is_used_and_which_is_ignored(tmp_path, model, weights, trainer, words, unused_name):
    report = load_checkpoint(write(tmp_path / "weights.pth", WRAPPED[trainer](weights)), model)
    assert len([note for note in report.notes if words in note]) == 1
    assert unused_name in report.left_aside
    num_unused = len(mmcv_ema_buffers(weights)) if trainer == "mmcv EMAHook" else len(weights)
    assert len([name for name in report.left_aside if not name.endswith("steps")]) == num_unused


def test_a_prefix_that_only_a_part_of_the_model_has_is_not_a_wrapper(tmp_path, model, weights):
    named = {f"module.{name}" if name.startswith("layer4.") else name: tensor for name, tensor in weights.items()}
    assert_refused(
        write(tmp_path / "weights.pth", named), model, "got 2: the top level, module", "--weights-key module"
    )


def test_an_ema_buffer_without_its_parameter_is_unexpected(tmp_path, model, weights):
    path = write(tmp_path / "weights.pth", weights | {"ema_layer9_weight": torch.zeros(3)})
    assert_refused(path, model, "1 unexpected: ema_layer9_weight")


def test_a_dictionary_that_contains_itself_is_refused(tmp_path, model):
    endless = {}
    endless |= {"model": endless, "state_dict": endless}
    assert_refused(write(tmp_path / "weights.pth", endless), model, "dictionary of named tensors")
