"""Tests of freezing. The rules of the backbone are those of mmdetection's ResNet and of PETR's VoVNetCP."""

import copy

import pytest
import torch
from torch import nn

from duospacenet.model import DuoSpaceNet
from duospacenet.model.backbones.resnet import ResNet
from duospacenet.model.backbones.vovnet import VoVNet
from duospacenet.model.config import ResNetConfig
from duospacenet.training.freezing import freeze, freeze_backbone
from tests.helpers.model_inputs import with_random_weights
from tests.helpers.trainings import TINY, new_trainer, settings_with, synthetic_training_frames
from tests.helpers.vovnets import SMALL as SMALL_VOVNET

BACKBONES = {
    "resnet": lambda: ResNet(ResNetConfig("bottleneck", (1, 1, 1, 1), width=8, deformable_stages=(3,))),
    "vovnet": lambda: VoVNet(SMALL_VOVNET),
}
# The first parts of the names of each stage, the stem first.
STAGES = {
    "resnet": [{"conv1", "bn1", "layer1"}, {"layer2"}, {"layer3"}, {"layer4"}],
    "vovnet": [{"stem", "stage2"}, {"stage3"}, {"stage4"}, {"stage5"}],
}


def step_on_random_images(backbone, seed=0):
    """Forward, backward and a step of AdamW with a large weight decay."""
    parameters = [parameter for parameter in backbone.parameters() if parameter.requires_grad]
    optimiser = torch.optim.AdamW([*parameters, nn.Parameter(torch.ones(1))], lr=1e-2, weight_decay=0.5)
    images = torch.randn(2, 3, 64, 64, generator=torch.Generator().manual_seed(seed), requires_grad=True)
    torch.stack([level.square().mean() for level in backbone(images)]).sum().backward()
    optimiser.step()


def unchanged_by_a_step(backbone, **settings):
    """The names of the tensors that stay the same in a training step with these settings."""
    before = copy.deepcopy(backbone.state_dict())
    freeze_backbone(backbone, settings_with(**settings))
    backbone.train()
    step_on_random_images(backbone)
    return {name for name, tensor in backbone.state_dict().items() if torch.equal(before[name], tensor)}


@pytest.mark.parametrize("num_stages", [0, 1, 2, 4])
@pytest.mark.parametrize("kind", BACKBONES)
def test_a_step_changes_no_tensor_of_a_frozen_stage_and_every_other_one(kind, num_stages):
    backbone = with_random_weights(BACKBONES[kind](), 0)
    names = list(backbone.state_dict())
    unchanged = unchanged_by_a_step(backbone, frozen_stages=num_stages)
    frozen = set().union(*STAGES[kind][:num_stages])
    assert list(backbone.state_dict()) == names
    assert unchanged == {name for name in names if name.partition(".")[0] in frozen}


@pytest.mark.parametrize("kind", BACKBONES)
def test_norms_in_evaluation_mode_do_not_change_and_the_convolutions_do(kind):
    backbone = with_random_weights(BACKBONES[kind](), 0)
    norms = [name for name, module in backbone.named_modules() if isinstance(module, nn.BatchNorm2d)]
    names = list(backbone.state_dict())
    unchanged = unchanged_by_a_step(backbone, backbone_norm_eval=True)
    assert unchanged == {name for name in names if name.rpartition(".")[0] in norms}


def test_frozen_norms_normalise_with_the_running_statistics_in_training_mode_too():
    backbone = with_random_weights(BACKBONES["resnet"](), 0)
    images = torch.randn(2, 3, 64, 64, generator=torch.Generator().manual_seed(0))
    with torch.no_grad():
        expected = copy.deepcopy(backbone).eval()(images)
        freeze_backbone(backbone, settings_with(backbone_norm_eval=True))
        for ours, theirs in zip(backbone.train()(images), expected, strict=True):
            assert torch.equal(ours, theirs)


def test_norms_with_fixed_statistics_compute_as_in_evaluation_mode_and_learn_their_parameters():
    """In every part of the model, with norms of images and of voxels."""
    frame = synthetic_training_frames(1, 1)[0]
    trainer = new_trainer(settings_with(norm_eval=True))
    with_random_weights(trainer.model, 0)
    with torch.no_grad():
        expected, ours = (
            model.encode(frame.images, frame.image_T_ego, frame.camera_valid)
            for model in (copy.deepcopy(trainer.model).eval(), trainer.model.train())
        )
        assert torch.equal(ours.bev, expected.bev)
        assert torch.equal(ours.pv[0], expected.pv[0])
    before = copy.deepcopy(trainer.model.state_dict())
    next(trainer.train_on([[frame]]))
    after = trainer.model.state_dict()
    norms = [name.removesuffix(".running_mean") for name in before if name.endswith(".running_mean")]
    assert {name.partition(".")[0] for name in norms} == {"image_encoder", "divergence_enhancement", "segmentation"}
    for norm in norms:
        assert not torch.equal(after[f"{norm}.weight"], before[f"{norm}.weight"]), norm
        for statistic in ("running_mean", "running_var", "num_batches_tracked"):
            assert torch.equal(after[f"{norm}.{statistic}"], before[f"{norm}.{statistic}"]), norm


def test_frozen_parts_have_no_gradient_and_the_others_keep_theirs():
    model = DuoSpaceNet(TINY)
    freeze(model, settings_with(frozen_parts=("lifter", "decoder")))
    trained = {name.partition(".")[0] for name, parameter in model.named_parameters() if parameter.requires_grad}
    assert trained == {"image_encoder", "divergence_enhancement", "queries", "segmentation"}


@pytest.mark.parametrize("settings", [{"frozen_stages": 1}, {"frozen_stages": 4}, {"backbone_norm_eval": True}])
def test_the_trainer_freezes_the_backbone_before_it_makes_the_optimiser(settings):
    trainer = new_trainer(settings_with(weight_decay=0.5, **settings))
    backbone = trainer.model.image_encoder.backbone
    frozen = {name: tensor.clone() for name, tensor in backbone.named_parameters() if not tensor.requires_grad}
    trainer.model.train()
    next(trainer.train_on([synthetic_training_frames(1, 1)]))
    assert frozen
    for name, tensor in frozen.items():
        assert torch.equal(backbone.get_parameter(name), tensor), name
    optimised = {id(parameter) for group in trainer.optimiser.param_groups for parameter in group["params"]}
    assert optimised.isdisjoint(id(backbone.get_parameter(name)) for name in frozen)
