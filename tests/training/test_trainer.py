"""A step of the training: what it looks at, what it changes, and what it refuses to."""

import copy

import pytest
import torch

from duospacenet.model.presets import ablate
from duospacenet.runtime.errors import CheckError
from duospacenet.training import Trainer
from tests.helpers.trainings import CPU, TINY, new_trainer, settings_with, synthetic_training_frames


def parameters_of(trainer):
    return {name: tensor.detach().clone() for name, tensor in trainer.model.named_parameters()}


def first_losses(settings, drives):
    """Of a step with running statistics, so that each frame's features do not hang on the other's."""
    trainer = new_trainer(settings)
    trainer.model.eval()
    return next(trainer.train_on(drives)).losses


@pytest.fixture(scope="module")
def samples():
    return synthetic_training_frames(1, 2)


def test_frames_are_encoded_together_as_the_model_encodes_each(samples):
    """Where normalisation goes by its running statistics: those of a batch hang on who else is in it."""
    trainer = new_trainer(settings_with())
    trainer.model.eval()
    with torch.no_grad():
        moments = trainer.encode(samples)
        for moment, sample in zip(moments, samples, strict=True):
            alone = trainer.model.encode(sample.images, sample.image_T_ego, sample.camera_valid)
            assert moment.frame is sample
            for ours, models in zip([*moment.features.pv, moment.features.bev], [*alone.pv, alone.bev], strict=True):
                torch.testing.assert_close(ours, models, atol=1e-5, rtol=1e-4)
    assert not torch.equal(moments[0].features.bev, moments[1].features.bev)


def test_steps_on_the_same_frame_lower_its_loss(samples):
    trainer = new_trainer(settings_with(steps=8, frames_per_clip=1, learning_rate=1e-3, backbone_learning_rate=1e-3))
    totals = [step.losses["total"] for _ in range(8) for step in trainer.train_on([samples[:1]])]
    assert len(totals) == 8
    assert totals[1] < totals[0]
    assert totals[-1] < 0.9 * totals[0]


def test_a_step_tells_its_losses_and_their_sum(samples):
    trainer = new_trainer(settings_with(steps=1))
    (step,) = trainer.train_on([samples[:1], samples[1:]])
    parts = {name: loss for name, loss in step.losses.items() if name != "total"}
    maps = {f"{loss}_{name}" for loss in ("focal", "dice") for name in TINY.map_classes}
    heads = {"heatmap_pv", "depth_pv", "appearance_pv", "heatmap_bev", "box_bev"}
    layers = {f"{loss}_{layer}" for loss in ("class", "box", "denoised") for layer in (0, 1)}
    assert parts.keys() == layers | heads | maps
    assert step.losses["total"] == pytest.approx(sum(parts.values()), rel=1e-5)
    assert (step.number, trainer.step) == (0, 1)
    assert step.gradient_norm > 0


def test_a_step_of_two_drives_has_the_mean_of_their_losses(samples):
    """With running statistics, so that each frame's features do not hang on the other's."""

    settings = settings_with(denoising=0)  # the noise is another in each
    groups = ([samples[:1]], [samples[1:]], [samples[:1], samples[1:]])
    one, other, both = (first_losses(settings, drives) for drives in groups)
    for name, loss in both.items():
        assert loss == pytest.approx((one[name] + other[name]) / 2, rel=1e-3), name


def test_every_parameter_learns(samples):
    """Nothing is left out of the losses: two steps, the second with a past, change every tensor."""
    trainer = new_trainer(settings_with(weight_decay=0.0))
    before = parameters_of(trainer)
    assert len(list(trainer.train_on([samples]))) == 2
    same = [name for name, tensor in parameters_of(trainer).items() if tensor.equal(before[name])]
    assert same == []


def test_what_stands_beside_the_paper_can_be_left_out(samples):
    plain = new_trainer(settings_with(denoising=0, pv_supervision=False, bev_supervision=False))
    names = next(plain.train_on([samples[:1]])).losses.keys()
    maps = {f"{loss}_{name}" for loss in ("focal", "dice") for name in TINY.map_classes}
    assert names == {"class_0", "box_0", "class_1", "box_1", "total"} | maps


def test_pre_training_changes_what_gives_the_finest_level_and_nothing_else(samples):
    """Not even by a weight decay: the coarser outputs of the pyramid, the lifter and the decoder stay as they were."""
    trainer = new_trainer(settings_with(pretraining=True, weight_decay=0.5))
    before = {name: tensor.clone() for name, tensor in trainer.model.state_dict().items()}
    steps = list(trainer.train_on([samples]))
    assert steps[0].losses.keys() == {"heatmap_pv", "depth_pv", "appearance_pv", "total"}
    after = trainer.model.state_dict()
    changed = {name for name, tensor in after.items() if not torch.equal(tensor, before[name])}
    unseen = ("image_encoder.neck.output.1", "image_encoder.neck.output.2", "image_encoder.neck.extra")
    seen = {name for name in before if name.startswith("image_encoder.") and not name.startswith(unseen)}
    assert changed == seen


def test_a_model_without_bev_features_learns_without_the_head_on_them():
    config = ablate(TINY, "pv")
    names = next(new_trainer(settings_with(), config).train_on([synthetic_training_frames(1, 1, config)])).losses.keys()
    assert {"heatmap_pv", "denoised_1"} <= names
    assert not any(name.endswith("_bev") for name in names)


def test_a_frame_without_objects_is_learned_from_beside_one_with_some(samples):
    empty = samples[0]._replace(boxes=samples[0].boxes[:0], labels=samples[0].labels[:0])
    groups = ([samples[1:]], [[empty], samples[1:]], [[empty]])
    alone, both, none = (first_losses(settings_with(), drives) for drives in groups)
    assert both.keys() == alone.keys() == none.keys()
    assert none["denoised_1"] == none["box_1"] == none["box_bev"] == 0
    assert both["class_1"] == pytest.approx((alone["class_1"] + none["class_1"]) / 2, rel=1e-3)


@pytest.mark.parametrize("num_boxes", [1, 3])
def test_where_each_space_has_its_own_queries_both_learn_from_any_number_of_objects(num_boxes):
    config = ablate(TINY, "unshared")
    trainer = new_trainer(settings_with(denoising=2), config)
    (sample,) = synthetic_training_frames(1, 1, config)
    few = sample._replace(boxes=sample.boxes[:num_boxes], labels=sample.labels[:num_boxes])
    assert next(trainer.train_on([[few]])).losses["denoised_1"] > 0


def test_the_noise_is_another_in_every_drive_and_step_and_the_same_again(samples):
    def denoised(*drives, **settings):
        trainer = new_trainer(settings_with(learning_rate=1e-9, backbone_learning_rate=1e-9, **settings))
        trainer.model.eval()
        return [step.losses["denoised_0"] for _ in range(2) for step in trainer.train_on(list(drives))]

    once, again = denoised(samples[:1]), denoised(samples[:1])
    assert once == again
    assert once[0] != once[1]
    assert once[0] != denoised(samples[:1], seed=1)[0]
    assert denoised(samples[:1], samples[:1])[0] != once[0]  # were it the same for both, so would be the mean


def test_the_clipped_gradient_is_what_is_stepped_with(samples):
    trainer = new_trainer(settings_with(clip_norm=0.5))
    step = next(trainer.train_on([samples[:1]]))
    assert step.gradient_norm > 0.5
    squares = [float((p.grad**2).sum()) for group in trainer.optimiser.param_groups for p in group["params"]]
    assert sum(squares) ** 0.5 == pytest.approx(0.5, rel=1e-3)


def test_drives_end_when_they_do_and_the_training_after_its_last_step(samples):
    trainer = new_trainer(settings_with(steps=3))
    assert len(list(trainer.train_on([samples[:1], samples]))) == 2
    assert len(list(trainer.train_on([samples, samples]))) == 1
    assert list(trainer.train_on([samples])) == []
    assert trainer.step == 3


@pytest.mark.parametrize(("broken", "what"), [("weights", "loss"), ("gradient", "gradient")])
def test_what_is_not_finite_ends_the_training_before_a_parameter_changes(samples, monkeypatch, broken, what):
    trainer = new_trainer(settings_with())
    if broken == "weights":
        with torch.no_grad():
            trainer.model.decoder.layers[0].feedforward[0].bias[0] = float("nan")
    else:
        trainer.model.queries.pose.register_hook(lambda gradient: gradient * float("inf"))
    before = parameters_of(trainer)
    with pytest.raises(CheckError, match=rf"step 0: expected a finite {what}; got (nan|inf).* smaller learning rate"):
        next(trainer.train_on([samples[:1]]))
    assert trainer.step == 0
    for name, tensor in parameters_of(trainer).items():
        assert torch.equal(tensor.nan_to_num(), before[name].nan_to_num()), name


def test_grid_masks_come_to_the_images_as_the_steps_go_on_and_hang_on_the_step_alone(samples):
    trainer = new_trainer(settings_with(steps=100, grid_mask=1.0))
    (sample, _) = samples
    assert torch.equal(trainer._mask_images(sample.images), sample.images)  # the probability begins at nothing
    trainer.step = 99
    masked = trainer._mask_images(sample.images)
    assert torch.equal(masked, trainer._mask_images(sample.images))
    share = (masked != sample.images).any(dim=-1).float().mean()
    assert 0.1 < share < 0.6
    changed = masked[(masked != sample.images).all(dim=-1)]
    assert changed.unique(dim=0).tolist() == [[103, 116, 123]]  # the mean colour, in the order of the images: BGR


def test_bfloat16_changes_the_losses_only_a_little(samples):
    exact, rough = (
        next(new_trainer(settings_with(bf16=bf16)).train_on([samples[:1]])).losses for bf16 in (False, True)
    )
    assert exact != rough
    assert rough["total"] == pytest.approx(exact["total"], rel=0.05)


def test_a_state_that_is_loaded_goes_on_bit_for_bit(samples):
    whole, first, then = (new_trainer(settings_with()) for _ in range(3))
    expected = [step for _ in range(2) for step in whole.train_on([samples])]
    steps = list(first.train_on([samples]))
    then.load_state_dict(copy.deepcopy(first.state_dict()))
    assert steps + list(then.train_on([samples])) == expected
    for name, tensor in whole.model.state_dict().items():
        assert torch.equal(tensor, then.model.state_dict()[name]), name


def test_a_trainer_hangs_on_its_seed_alone_and_leaves_torchs_generator_where_it_was(tiny_model):
    heads = []
    with torch.random.fork_rng():
        for global_seed in (5, 6):
            torch.manual_seed(global_seed)
            before = torch.get_rng_state()
            trainer = Trainer(copy.deepcopy(tiny_model), settings_with(seed=3), CPU)
            assert torch.equal(torch.get_rng_state(), before)
            heads.append(trainer.heads.state_dict())
    assert all(torch.equal(tensor, heads[1][name]) for name, tensor in heads[0].items())
