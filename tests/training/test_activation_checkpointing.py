"""Tests of activation checkpointing: the same numbers as without it, with less memory."""

import copy
from dataclasses import replace

import pytest
import torch
from torch import nn
from torch.nn.parallel import DistributedDataParallel

from duospacenet.model import DuoSpaceNet
from duospacenet.model.presets import ablate
from duospacenet.training import initialise
from duospacenet.training.activation_checkpointing import checkpoint_activations
from duospacenet.training.objective import Sample
from tests.helpers.trainings import TINY, new_trainer, settings_with, synthetic_training_frames
from tests.helpers.vovnets import SMALL as SMALL_VOVNET

VARIANTS = {
    "duo space": TINY,
    "a VoVNet": replace(TINY, backbone=SMALL_VOVNET),
    "stacking": ablate(TINY, "stacking"),
    "attention": ablate(TINY, "attention"),
    "PV only": ablate(TINY, "pv"),
}


def train_two_steps(config, checkpointing, **settings):
    """The losses and the state after two steps, the second with a past frame."""
    trainer = new_trainer(settings_with(dropout=0.1, **settings), config)
    assert any(isinstance(module, nn.Dropout) and module.p for module in trainer.model.modules())
    if checkpointing:
        checkpoint_activations(trainer.model)
    losses = [step.losses for step in trainer.train_on([synthetic_training_frames(1, 2, config)])]
    return losses, trainer.model.state_dict()


@pytest.mark.parametrize("variant", VARIANTS)
def test_losses_weights_and_running_statistics_equal_those_without_checkpointing(variant):
    """After two steps, the weights depend on every gradient, and the second losses on the running statistics."""
    (plain, expected), (checkpointed, state) = (train_two_steps(VARIANTS[variant], on) for on in (False, True))
    assert checkpointed == plain
    assert list(state) == list(expected)
    for name, tensor in expected.items():
        assert torch.equal(state[name], tensor), name


@pytest.mark.parametrize("settings", [{"amp": "bfloat16"}, {"frozen_stages": 2, "backbone_norm_eval": True}])
def test_checkpointing_works_with_mixed_precision_and_a_frozen_backbone(settings):
    (plain, expected), (checkpointed, state) = (train_two_steps(TINY, on, **settings) for on in (False, True))
    assert checkpointed == plain
    assert all(torch.equal(state[name], tensor) for name, tensor in expected.items())


def stored_bytes(module, *inputs):
    """The bytes that autograd stores for the outputs of a module, without its parameters."""
    excluded = {tensor.untyped_storage().data_ptr() for tensor in module.parameters()}
    stored = {}

    def pack(tensor):
        storage = tensor.untyped_storage()
        stored[storage.data_ptr()] = storage.nbytes()
        return tensor

    with torch.autograd.graph.saved_tensors_hooks(pack, lambda tensor: tensor):
        outputs = module(*inputs)
    assert outputs is not None  # they keep what is stored alive, so that no address occurs twice
    return sum(size for address, size in stored.items() if address not in excluded)


PARTS = {
    "a stage of a ResNet": (TINY, "backbone.layer1", torch.rand(2, 8, 16, 40)),
    "the stem of a VoVNet": (VARIANTS["a VoVNet"], "backbone.stem", torch.rand(2, 3, 64, 160)),
    "the neck": (TINY, "neck", [torch.rand(2, 8 * 2**i, 8 // 2**i, 20 // 2**i) for i in (1, 2, 3)]),
}


@pytest.mark.parametrize("part", PARTS)
def test_checkpointing_stores_less_than_half(part):
    config, name, inputs = PARTS[part]
    encoder = initialise(DuoSpaceNet(config), 0).train().image_encoder
    plain = stored_bytes(encoder.get_submodule(name), inputs)
    checkpoint_activations(encoder)
    assert stored_bytes(encoder.get_submodule(name), inputs) < 0.5 * plain


def test_a_copy_of_a_checkpointed_model_is_a_model_of_its_own():
    """Moving averages are copies."""
    model = initialise(DuoSpaceNet(TINY), 0).train()
    checkpoint_activations(model)
    duplicate = copy.deepcopy(model)
    (frame,) = synthetic_training_frames(1, 1)
    duplicate.encode(frame.images, frame.image_T_ego, frame.camera_valid).bev.sum().backward()
    assert all(parameter.grad is None for parameter in model.parameters())
    assert duplicate.image_encoder.backbone.layer1[0].conv1.weight.grad is not None
    before = model.image_encoder.backbone.layer1[0].bn1.num_batches_tracked
    assert (int(before), int(duplicate.image_encoder.backbone.layer1[0].bn1.num_batches_tracked)) == (0, 1)


def test_checkpointing_works_in_distributed_data_parallel():
    """One process: the reducer marks each parameter when its gradient is ready, and refuses a second time."""
    (frame,) = synthetic_training_frames(1, 1)

    def gradients(wrap, checkpointing):
        trainer = new_trainer(settings_with(denoising=2))
        if checkpointing:
            checkpoint_activations(trainer.model)
        losses, _ = wrap(trainer.objective)([Sample(frame, [], 0)], 0)
        losses.sum().backward()
        return {name: parameter.grad for name, parameter in trainer.model.named_parameters()}

    expected = gradients(lambda objective: objective, checkpointing=False)
    torch.distributed.init_process_group("gloo", store=torch.distributed.HashStore(), rank=0, world_size=1)
    try:
        actual = gradients(DistributedDataParallel, checkpointing=True)
    finally:
        torch.distributed.destroy_process_group()
    for name, gradient in expected.items():
        assert torch.equal(actual[name], gradient), name
