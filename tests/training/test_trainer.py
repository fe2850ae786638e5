"""Tests of the trainer: encoding, losses, parameter updates and its state."""

import copy

import pytest
import torch

from duospacenet.model.presets import ablate
from duospacenet.runtime.errors import CheckError, UsageError
from duospacenet.training import Trainer
from tests.helpers.trainings import CPU, TINY, new_trainer, settings_with, synthetic_training_frames


def parameters_of(trainer):
    return {name: tensor.detach().clone() for name, tensor in trainer.model.named_parameters()}


def first_losses(settings, batch):
    """The losses of one step with running statistics, so that the frames of a batch do not influence each other."""
    trainer = new_trainer(settings)
    trainer.model.eval()
    return next(trainer.train_on(batch)).losses


@pytest.fixture(scope="module")
def frames():
    return synthetic_training_frames(1, 2)


# --- Losses -------------------------------------------------------------------------------------------------------


def test_repeated_steps_on_one_frame_lower_its_loss(frames):
    trainer = new_trainer(settings_with(steps=8, frames_per_clip=1, learning_rate=1e-3, backbone_learning_rate=1e-3))
    totals = [step.losses["total"] for _ in range(8) for step in trainer.train_on([frames[:1]])]
    assert len(totals) == 8
    assert totals[1] < totals[0]
    assert totals[-1] < 0.9 * totals[0]


def test_a_step_reports_all_losses_and_their_sum(frames):
    trainer = new_trainer(settings_with(steps=1))
    (step,) = trainer.train_on([frames[:1], frames[1:]])
    parts = {name: loss for name, loss in step.losses.items() if name != "total"}
    maps = {f"{loss}_{name}" for loss in ("focal", "dice") for name in TINY.map_classes}
    heads = {"heatmap_pv", "depth_pv", "appearance_pv", "heatmap_bev", "box_bev"}
    layers = {f"{loss}_{layer}" for loss in ("class", "box", "denoised") for layer in (0, 1)}
    assert parts.keys() == layers | heads | maps
    assert step.losses["total"] == pytest.approx(sum(parts.values()), rel=1e-5)
    assert (step.number, trainer.step) == (0, 1)
    assert step.gradient_norm > 0


def test_the_losses_of_a_batch_are_the_mean_over_its_clips(frames):
    settings = settings_with(denoising=0)  # the noise differs between the clips of a batch
    batches = ([frames[:1]], [frames[1:]], [frames[:1], frames[1:]])
    one, other, both = (first_losses(settings, batch) for batch in batches)
    for name, loss in both.items():
        assert loss == pytest.approx((one[name] + other[name]) / 2, rel=1e-3), name


def test_everything_beyond_the_paper_can_be_switched_off(frames):
    plain = new_trainer(settings_with(denoising=0, pv_supervision=False, bev_supervision=False))
    names = next(plain.train_on([frames[:1]])).losses.keys()
    maps = {f"{loss}_{name}" for loss in ("focal", "dice") for name in TINY.map_classes}
    assert names == {"class_0", "box_0", "class_1", "box_1", "total"} | maps


def test_a_model_without_bev_features_is_trained_without_bev_supervision():
    config = ablate(TINY, "pv")
    batch = [synthetic_training_frames(1, 1, config)]
    names = next(new_trainer(settings_with(), config).train_on(batch)).losses.keys()
    assert {"heatmap_pv", "denoised_1"} <= names
    assert not any(name.endswith("_bev") for name in names)


def test_a_frame_without_objects_can_be_in_a_batch(frames):
    empty = frames[0]._replace(boxes=frames[0].boxes[:0], labels=frames[0].labels[:0])
    batches = ([frames[1:]], [[empty], frames[1:]], [[empty]])
    full_only, both, empty_only = (first_losses(settings_with(), batch) for batch in batches)
    assert both.keys() == full_only.keys() == empty_only.keys()
    assert empty_only["denoised_1"] == empty_only["box_1"] == empty_only["box_bev"] == 0
    assert both["class_1"] == pytest.approx((full_only["class_1"] + empty_only["class_1"]) / 2, rel=1e-3)


@pytest.mark.parametrize("num_boxes", [1, 3])
def test_denoising_works_with_unshared_queries_for_any_number_of_objects(num_boxes):
    config = ablate(TINY, "unshared")
    trainer = new_trainer(settings_with(denoising=2), config)
    (frame,) = synthetic_training_frames(1, 1, config)
    few = frame._replace(boxes=frame.boxes[:num_boxes], labels=frame.labels[:num_boxes])
    assert next(trainer.train_on([[few]])).losses["denoised_1"] > 0


def test_the_noise_differs_between_clips_steps_and_seeds_and_is_reproducible(frames):
    def denoised(*batch, **settings):
        trainer = new_trainer(settings_with(learning_rate=1e-9, backbone_learning_rate=1e-9, **settings))
        trainer.model.eval()
        return [step.losses["denoised_0"] for _ in range(2) for step in trainer.train_on(list(batch))]

    once, again = denoised(frames[:1]), denoised(frames[:1])
    assert once == again
    assert once[0] != once[1]
    assert once[0] != denoised(frames[:1], seed=1)[0]
    assert denoised(frames[:1], frames[:1])[0] != once[0]  # equal noise in both clips would give an equal mean


def test_bfloat16_changes_the_losses_by_a_few_percent_only(frames):
    float32, bfloat16 = (
        next(new_trainer(settings_with(amp=amp)).train_on([frames[:1]])).losses for amp in ("off", "bfloat16")
    )
    assert float32 != bfloat16
    assert bfloat16["total"] == pytest.approx(float32["total"], rel=0.05)


# --- Parameter updates --------------------------------------------------------------------------------------------


def test_two_steps_change_every_parameter(frames):
    """The second step has a past frame."""
    trainer = new_trainer(settings_with(weight_decay=0.0))
    before = parameters_of(trainer)
    assert len(list(trainer.train_on([frames]))) == 2
    unchanged = [name for name, tensor in parameters_of(trainer).items() if tensor.equal(before[name])]
    assert unchanged == []


def test_pretraining_changes_only_the_parameters_that_the_finest_level_depends_on(frames):
    """Despite the weight decay, the coarser pyramid outputs, the lifter and the decoder do not change."""
    trainer = new_trainer(settings_with(pretraining=True, weight_decay=0.5))
    before = {name: tensor.clone() for name, tensor in trainer.model.state_dict().items()}
    steps = list(trainer.train_on([frames]))
    assert steps[0].losses.keys() == {"heatmap_pv", "depth_pv", "appearance_pv", "total"}
    after = trainer.model.state_dict()
    changed = {name for name, tensor in after.items() if not torch.equal(tensor, before[name])}
    coarser = ("image_encoder.neck.output.1", "image_encoder.neck.output.2", "image_encoder.neck.extra")
    assert changed == {name for name in before if name.startswith("image_encoder.") and not name.startswith(coarser)}


def test_the_optimiser_uses_the_clipped_gradient(frames):
    trainer = new_trainer(settings_with(clip_norm=0.5))
    step = next(trainer.train_on([frames[:1]]))
    assert step.gradient_norm > 0.5
    squares = [float((p.grad**2).sum()) for group in trainer.optimiser.param_groups for p in group["params"]]
    assert sum(squares) ** 0.5 == pytest.approx(0.5, rel=1e-3)


@pytest.mark.parametrize(("broken", "quantity"), [("weights", "loss"), ("gradient", "gradient")])
def test_a_loss_or_gradient_that_is_not_finite_stops_the_training_before_any_update(
    frames, monkeypatch, broken, quantity
):
    trainer = new_trainer(settings_with())
    if broken == "weights":
        with torch.no_grad():
            trainer.model.decoder.layers[0].feedforward[0].bias[0] = float("nan")
    else:
        trainer.model.queries.pose.register_hook(lambda gradient: gradient * float("inf"))
    before = parameters_of(trainer)
    message = rf"step 1: expected a finite {quantity}; got (nan|inf).* smaller learning rate"
    with pytest.raises(CheckError, match=message):
        next(trainer.train_on([frames[:1]]))
    assert trainer.step == 0
    for name, tensor in parameters_of(trainer).items():
        assert torch.equal(tensor.nan_to_num(), before[name].nan_to_num()), name


def test_a_batch_that_does_not_fit_into_the_memory_is_refused_with_advice(frames, monkeypatch):
    def out_of_memory(*_):
        raise torch.OutOfMemoryError("CUDA out of memory. Tried to allocate 2.00 GiB. GPU 0 has a total capacity ...")

    trainer = new_trainer(settings_with())
    monkeypatch.setattr(trainer.model, "detect", out_of_memory)
    message = "step 1: expected a batch that fits into the memory of cpu; got CUDA out of memory. Use more --accum"
    with pytest.raises(UsageError, match=message):
        next(trainer.train_on([frames[:1]]))


# --- float16 ------------------------------------------------------------------------------------------------------


def float16_trainer(loss_scale):
    trainer = new_trainer(settings_with(amp="float16"))
    state = trainer.state_dict()
    state["loss_scale"]["scale"] = loss_scale
    trainer.load_state_dict(state)
    return trainer


def test_a_gradient_beyond_float16_is_skipped_and_halves_the_loss_scale(frames):
    trainer = float16_trainer(2.0**120)  # the scaled gradients exceed the range of float32, too
    before = parameters_of(trainer)
    (step,) = trainer.train_on([frames[:1]])
    assert step.gradient_norm is None
    assert 0 < step.losses["total"] < 1000
    assert trainer.state_dict()["loss_scale"]["scale"] == 2.0**119
    assert all(torch.equal(tensor, before[name]) for name, tensor in parameters_of(trainer).items())
    assert trainer.step == 1


def test_float16_changes_the_losses_by_a_few_percent_only(frames):
    float32, float16 = (
        next(trainer.train_on([frames[:1]])) for trainer in (new_trainer(settings_with()), float16_trainer(1024.0))
    )
    assert float32.losses != float16.losses
    assert float16.losses["total"] == pytest.approx(float32.losses["total"], rel=0.01)
    assert float16.gradient_norm == pytest.approx(float32.gradient_norm, rel=0.05)


def test_a_gradient_that_is_not_finite_stops_a_training_in_float16_at_the_smallest_loss_scale(frames):
    trainer = float16_trainer(1.0)
    trainer.model.queries.pose.register_hook(lambda gradient: gradient * float("inf"))
    with pytest.raises(CheckError, match="step 1: expected a finite gradient; got"):
        next(trainer.train_on([frames[:1]]))


# --- Past frames --------------------------------------------------------------------------------------------------


def first_totals(frames, **settings):
    """The total losses of the steps of one clip, with learning rates that change nothing."""
    trainer = new_trainer(settings_with(learning_rate=1e-12, backbone_learning_rate=1e-12, denoising=0, **settings))
    trainer.model.eval()
    return [step.losses["total"] for step in trainer.train_on([frames])]


def test_a_window_has_the_loss_of_the_same_frames_in_a_stream(frames):
    """With constant weights and running statistics, the features of past frames are the same."""
    (in_window,) = first_totals(frames, history="windows")
    assert in_window == pytest.approx(first_totals(frames)[-1], rel=1e-5)
    assert in_window != first_totals(frames[-1:])[0]


@pytest.mark.parametrize("history", ["stream", "windows"])
def test_no_past_frames_are_used_if_none_are_wanted(frames, history):
    assert first_totals(frames, history=history, past_frames=0)[-1] == first_totals(frames[-1:])[0]


# --- Steps and state ----------------------------------------------------------------------------------------------


def test_a_batch_ends_with_its_longest_clip_and_the_training_with_its_last_step(frames):
    trainer = new_trainer(settings_with(steps=3))
    assert len(list(trainer.train_on([frames[:1], frames]))) == 2
    assert len(list(trainer.train_on([frames, frames]))) == 1
    assert list(trainer.train_on([frames])) == []
    assert trainer.step == 3


@pytest.mark.parametrize(
    "settings",
    [
        {},
        {"ema_decay": 0.9, "denoising": 2},
        {"amp": "float16"},
        {"history": "windows", "grid_mask": 0.7, "grid_mask_ramp": False, "dropout": 0.1},
    ],
)
def test_a_trainer_with_a_restored_state_continues_bit_for_bit(frames, settings):
    uninterrupted, first, second = (new_trainer(settings_with(**settings)) for _ in range(3))
    expected = [step for _ in range(2) for step in uninterrupted.train_on([frames])]
    steps = list(first.train_on([frames]))
    second.load_state_dict(copy.deepcopy(first.state_dict()))
    assert steps + list(second.train_on([frames])) == expected
    torch.testing.assert_close(second.state_dict(), uninterrupted.state_dict(), rtol=0, atol=0)


def test_a_trainer_depends_on_its_seed_only_and_leaves_the_global_generator_unchanged(tiny_model):
    heads = []
    with torch.random.fork_rng():
        for global_seed in (5, 6):
            torch.manual_seed(global_seed)
            before = torch.get_rng_state()
            trainer = Trainer(copy.deepcopy(tiny_model), settings_with(seed=3), CPU)
            assert torch.equal(torch.get_rng_state(), before)
            heads.append(trainer.heads.state_dict())
    assert all(torch.equal(tensor, heads[1][name]) for name, tensor in heads[0].items())
