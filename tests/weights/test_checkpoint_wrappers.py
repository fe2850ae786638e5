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
    "Lightning with a loss and metrics beside the model": lambda w: {
        "state_dict": prefixed("model.", w) | LOSSES | {"val_map.confusion": torch.zeros(3, 3)},
        "optimizer_states": [{"state": {0: {"exp_avg": torch.zeros(3)}}}],
    },
    "Lightning, the module is the model": lambda w: {"state_dict": w | LOSSES},
    "Lightning's WeightAveraging": lambda w: {
        "state_dict": prefixed("model.", w),
        "current_model_state": prefixed("model.", altered(w)),
        "averaging_state": {"n_averaged": torch.tensor(7)},
    },
    "a shadow beside the model": lambda w: {"model": altered(w), "ema": {"shadow": w, "decay": 0.999}},
    "a shadow with tensors as its settings": lambda w: {
        "model": altered(w),
        "ema": {"shadow": prefixed("module.", w), "decay": torch.tensor(0.999), "num_updates": torch.tensor(4)},
    },
    "a shadow of the same tensors": lambda w: {"model": w, "ema": {"shadow": w}},
    "an average without mmengine's counter": lambda w: {"state_dict": altered(w), "ema_state_dict": w},
    "an averaged model": lambda w: {
        "model": altered(w),
        "averaged_model": prefixed("module.", w) | {"n_averaged": torch.tensor(5)},
    },
    "ema_pytorch": lambda w: {
        "ema": prefixed("online_model.", altered(w)) | prefixed("ema_model.", w) | {"step": torch.tensor([5])}
    },
    "an average in a callback": lambda w: {"state_dict": altered(w), "callbacks": {"EMACallback": {"ema_weights": w}}},
    "BasicSR": lambda w: {"params": altered(w), "params_ema": w},
    "an average without names": lambda w: {"model": w, "ema": {"shadow_params": list(altered(w).values())}},
    "an average with settings only": lambda w: {"model": w, "ema": {"decay": torch.tensor(0.9)}},
    "an empty average": lambda w: {"state_dict": w, "state_dict_ema": {}},
    "OpenPCDet": lambda w: {"model_state": w, "optimizer_state": {"state": prefixed("a.", altered(w))}},
    "another key": lambda w: {"epoch": 3, "weights": w},
    "three deep": lambda w: {"checkpoint": {"best": {"net": w, "mAP": 0.4}}, "epoch": 7},
    "a list": lambda w: [w],
    "a tuple": lambda w: (w, {"state": {0: {"exp_avg": torch.zeros(3)}}}, 12),
    "a tuple in a dictionary": lambda w: {"network": (3, w)},
    "FSDP": lambda w: prefixed("_fsdp_wrapped_module.", w),
    "FSDP in each block": lambda w: {name.replace(".0.conv", ".0._fsdp_wrapped_module.conv"): w[name] for name in w},
    "checkpointed activations": lambda w: {
        name.replace("layer2.", "layer2._checkpoint_wrapped_module."): tensor for name, tensor in w.items()
    },
    "torch.compile of a part": lambda w: {name.replace("layer1.", "layer1._orig_mod."): w[name] for name in w},
    "DeepSpeed's model states": lambda w: {"module": w, "dp_world_size": 8, "optimizer": None, "ds_version": "0.14"},
    "an optimizer with names": lambda w: {"model": w, "optimizer": {"exp_avg": altered(w), "exp_avg_sq": altered(w)}},
    "plain values among the tensors": lambda w: w | {"epoch": 3, "classes": ["car"]},
    "parameters": lambda w: {"model": {n: torch.nn.Parameter(t, False) for n, t in w.items()}},
}
# Buffers of loss functions and metrics.
LOSSES = {
    "criterion.empty_weight": torch.ones(11),
    "loss_cls.pos_weight": torch.ones(10),
    "focal_loss.alpha": torch.ones(1),
    "train_metrics.accuracy.total": torch.ones(1),
}
WRAPPERS = {
    "mmengine": ("state_dict",),
    "timm": ("state_dict_ema",),
    "torchvision references": ("model_ema", "module"),
    "RT-DETR": ("ema", "module"),
    "mmcv EMAHook": ("state_dict",),
    "Lightning with a model beside its average": ("state_dict", "ema_model", "module"),
    "Lightning with a loss and metrics beside the model": ("state_dict", "model"),
    "a shadow beside the model": ("ema", "shadow"),
    "an averaged model": ("averaged_model", "module"),
    "ema_pytorch": ("ema", "ema_model"),
    "an average without names": ("model",),
    "three deep": ("checkpoint", "best", "net"),
    "a tuple": ("0",),
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
        ("a shadow beside the model", "used ema.shadow; ignored model", "model.conv1.weight"),
        (
            "Lightning's WeightAveraging",
            "used state_dict.model (the average: Lightning saves the raw weights as current_model_state); ignored",
            "current_model_state.model.conv1.weight",
        ),
        ("an average without mmengine's counter", "used ema_state_dict; ignored state_dict", "state_dict.conv1.weight"),
    ],
)
def test_the_report_says_which_copy_is_used_and_which_is_ignored(tmp_path, model, weights, trainer, words, unused_name):
    report = load_checkpoint(write(tmp_path / "weights.pth", WRAPPED[trainer](weights)), model)
    assert len([note for note in report.notes if words in note]) == 1
    assert unused_name in report.left_aside
    num_unused = len(mmcv_ema_buffers(weights)) if trainer == "mmcv EMAHook" else len(weights)
    assert len([name for name in report.left_aside if not name.endswith(("steps", "n_averaged"))]) == num_unused


def test_an_average_without_names_is_noted(tmp_path, model, weights):
    path = write(tmp_path / "weights.pth", WRAPPED["an average without names"](weights))
    expected = "an average without the model's tensor names is not used: ema.shadow_params"
    assert load_checkpoint(path, model).notes == (expected,)


def test_losses_are_recorded_as_not_used(tmp_path, model, weights):
    for trainer in ("Lightning, the module is the model", "Lightning with a loss and metrics beside the model"):
        report = load_checkpoint(write(tmp_path / "weights.pth", WRAPPED[trainer](weights)), model)
        assert {name.removeprefix("state_dict.") for name in report.left_aside} >= LOSSES.keys()


def test_a_shadow_of_the_parameters_is_completed_with_the_statistics_of_the_model(tmp_path, model, weights):
    """The usual EMA class registers `named_parameters()`, and applies them to the model with its statistics."""
    statistics = ("running_mean", "running_var", "num_batches_tracked")
    raw = altered(weights)
    shadow = {name: tensor for name, tensor in weights.items() if not name.endswith(statistics)}
    path = write(tmp_path / "weights.pth", {"model": prefixed("module.", raw), "ema": {"shadow": shadow}})
    report = load_checkpoint(path, model)
    assert_holds(model, raw | shadow)
    count = len(raw) - len(shadow)
    words = f"used ema.shadow; ignored model.module, except for {count} tensors that ema.shadow lacks"
    assert [words in note for note in report.notes] == [True]
    assert len(report.left_aside) == len(shadow)


def test_a_damaged_number_in_an_unused_copy_does_not_matter(tmp_path, model, weights):
    broken = weights | {"conv1.weight": weights["conv1.weight"] * torch.nan}
    load_checkpoint(write(tmp_path / "weights.pth", {"model": broken, "model_ema": weights}), model)
    assert_holds(model, weights)


def test_an_ema_buffer_without_its_parameter_is_unexpected(tmp_path, model, weights):
    path = write(tmp_path / "weights.pth", weights | {"ema_layer9_weight": torch.zeros(3)})
    assert_refused(path, model, "1 unexpected: ema_layer9_weight")


def test_a_dictionary_that_contains_itself_is_refused(tmp_path, model):
    endless = {}
    endless |= {"model": endless, "state_dict": endless}
    assert_refused(write(tmp_path / "weights.pth", endless), model, "dictionary of named tensors")
