"""Tests of the objective: encoding, the sums of losses, samples without ground truth, and parameters without loss."""

import pytest
import torch

from duospacenet.model import DuoSpaceNet
from duospacenet.model.presets import ablate
from duospacenet.training import initialise
from duospacenet.training.objective import Objective, Sample
from tests.helpers.trainings import TINY, settings_with, synthetic_training_frames


@pytest.fixture(scope="module")
def frames():
    return synthetic_training_frames(1, 2)


def new_objective(config=TINY, **settings):
    settings = settings_with(**settings)
    return Objective(initialise(DuoSpaceNet(config), settings.seed), settings)


def gradients(objective, samples):
    objective.zero_grad(set_to_none=True)
    losses, _ = objective(samples, 0)
    losses.sum().backward()
    return {name: parameter.grad for name, parameter in objective.named_parameters()}


# --- Encoding -----------------------------------------------------------------------------------------------------


def test_frames_encoded_in_one_batch_have_the_features_of_each_frame_alone(frames):
    """With running statistics: batch statistics depend on the other frames."""
    objective = new_objective().eval()
    with torch.no_grad():
        encoded = objective.encode(frames, 0, [0, 1])
        for one, frame in zip(encoded, frames, strict=True):
            alone = objective.model.encode(frame.images, frame.image_T_ego, frame.camera_valid)
            assert one.frame is frame
            for ours, expected in zip([*one.features.pv, one.features.bev], [*alone.pv, alone.bev], strict=True):
                torch.testing.assert_close(ours, expected, atol=1e-5, rtol=1e-4)
    assert not torch.equal(encoded[0].features.bev, encoded[1].features.bev)


def test_the_grid_mask_grows_with_the_steps(frames):
    objective = new_objective(steps=100, grid_mask=1.0)
    images = frames[0].images
    assert torch.equal(objective._mask(images, 0, 0, 0), images)  # the probability is 0 at step 0
    masked = objective._mask(images, 99, 0, 0)
    share = (masked != images).any(dim=-1).float().mean()
    assert 0.1 < share < 0.6
    changed = masked[(masked != images).all(dim=-1)]
    assert changed.unique(dim=0).tolist() == [[103, 116, 123]]  # the mean colour, BGR like the images


def test_a_constant_grid_mask_has_its_probability_at_the_first_step(frames):
    objective = new_objective(steps=100, grid_mask=1.0, grid_mask_ramp=False)
    assert not torch.equal(objective._mask(frames[0].images, 0, 0, 0), frames[0].images)


def test_the_grid_mask_differs_between_steps_clips_and_past_frames_and_is_reproducible(frames):
    objective, images = new_objective(grid_mask=1.0, grid_mask_ramp=False), frames[0].images
    masked = [objective._mask(images, *numbers) for numbers in ((0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1), (0, 0, 0))]
    assert torch.equal(masked[0], masked[4])
    assert not any(torch.equal(masked[0], other) for other in masked[1:4])


# --- Losses -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("config", "settings"),
    [
        (TINY, {}),
        (TINY, {"denoising": 0, "pv_supervision": False, "bev_supervision": False}),
        (TINY, {"tasks": "detection"}),
        (TINY, {"tasks": "maps"}),
        (TINY, {"pretraining": True}),
        (ablate(TINY, "pv"), {}),
        (ablate(TINY, "bev"), {}),
        (ablate(TINY, "stacking"), {}),
        (ablate(TINY, "attention"), {}),
    ],
)
def test_every_parameter_that_needs_a_gradient_gets_one_with_and_without_samples(frames, config, settings):
    """DistributedDataParallel would otherwise report an error, or wait without end."""
    objective = new_objective(config, **settings)
    (frame,) = synthetic_training_frames(1, 1, config)
    for samples in ([Sample(frame, [], 0)], []):
        for name, gradient in gradients(objective, samples).items():
            assert (gradient is not None) == objective.get_parameter(name).requires_grad, name
    assert all(not gradient.any() for gradient in gradients(objective, []).values() if gradient is not None)


def test_no_samples_have_losses_of_zero_with_the_same_names(frames):
    objective = new_objective()
    empty, features = objective([], 0)
    full, _ = objective([Sample(frames[0], [], 0)], 0)
    assert empty.shape == full.shape == (len(objective.loss_names),)
    assert not empty.any()
    assert features == []
    assert (full > 0).all()


def test_the_losses_of_two_samples_are_the_sum_of_their_losses(frames):
    objective = new_objective().eval()
    samples = [Sample(frame, [], clip) for clip, frame in enumerate(frames)]
    with torch.no_grad():
        both, _ = objective(samples, 0)
        one, other = (objective([sample], 0)[0] for sample in samples)
    torch.testing.assert_close(both, one + other, rtol=1e-4, atol=1e-5)


def test_the_weight_of_a_sample_scales_its_class_and_box_losses_only(frames):
    objective = new_objective().eval()
    with torch.no_grad():
        plain, weighted = (objective([Sample(frames[0], [], 0, weight)], 0)[0] for weight in (1.0, 3.0))
    ratio = dict(zip(objective.loss_names, (weighted / plain).tolist(), strict=True))
    expected = {name: 3.0 if name.startswith(("class_", "box_")) and name[-1].isdigit() else 1.0 for name in ratio}
    assert ratio == pytest.approx(expected)


def test_a_frame_with_unknown_boxes_is_trained_on_its_maps_only(frames):
    unknown = frames[0]._replace(
        boxes_known=torch.tensor(False), boxes=frames[0].boxes[:0], labels=frames[0].labels[:0]
    )
    objective = new_objective()
    losses = dict(zip(objective.loss_names, objective([Sample(unknown, [], 0)], 0)[0].tolist(), strict=True))
    assert all((loss > 0) == name.startswith(("focal_", "dice_")) for name, loss in losses.items())
    found = gradients(objective, [Sample(unknown, [], 0)])
    assert all(not gradient.any() for name, gradient in found.items() if name.startswith("model.decoder."))
    assert found["model.segmentation.enter.0.weight"].any()


# --- Past frames --------------------------------------------------------------------------------------------------


def test_past_frames_without_features_are_encoded_with_the_current_weights_and_without_gradient(frames):
    objective = new_objective().eval()
    newest, past = frames[1], frames[0]
    encoded = objective.encode([past], 0, [0])[0].detached()
    (from_images, _), (from_features, _) = (objective([Sample(newest, [one], 0)], 0) for one in (past, encoded))
    assert torch.equal(from_images, from_features)
    alone, _ = objective([Sample(newest, [], 0)], 0)
    assert not torch.equal(alone, from_images)
    with_images = gradients(objective, [Sample(newest, [past], 0)])
    with_features = gradients(objective, [Sample(newest, [encoded], 0)])
    assert all(torch.equal(gradient, with_features[name]) for name, gradient in with_images.items())


# --- Dropout ------------------------------------------------------------------------------------------------------


def test_dropout_depends_on_the_step_and_the_clip_only_and_leaves_the_global_generator_unchanged(frames):
    model = initialise(DuoSpaceNet(TINY), 0)
    model.decoder.layers[0].feedforward.append(torch.nn.Dropout())
    objective = Objective(model, settings_with(dropout=0.5, denoising=0))

    def losses(step, clip):
        state = torch.get_rng_state()
        result = objective([Sample(frames[0], [], clip)], step)[0].tolist()
        assert torch.equal(torch.get_rng_state(), state)
        return result

    first = losses(0, 0)
    with torch.random.fork_rng():
        torch.manual_seed(5)
        assert losses(0, 0) == first
    assert losses(1, 0) != first
    assert losses(0, 1) != first


def test_all_dropout_layers_get_the_rate_of_the_settings():
    model = initialise(DuoSpaceNet(TINY), 0)
    model.decoder.layers[0].feedforward.append(torch.nn.Dropout())
    Objective(model, settings_with(dropout=0.25))
    assert {module.p for module in model.modules() if isinstance(module, torch.nn.Dropout)} == {0.25}
