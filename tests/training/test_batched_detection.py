"""Detection in several windows with one call of the decoder, against one call per window."""

from functools import cache

import pytest
import torch

from duospacenet.model import PRESETS, DuoSpaceNet
from duospacenet.model.random_weights import randomise
from duospacenet.training.batched_detection import detect_batch
from duospacenet.training.encoded_frames import EncodedFrame, decoder_inputs
from duospacenet.training.samples.synthetic_clips import SyntheticClips
from duospacenet.training.samples.training_frames import make_training_frame
from duospacenet.weights.input_contract import preprocessing
from tests.helpers.model_inputs import assert_close

ROWS = ["tiny", "tiny-pv", "tiny-bev", "tiny-unshared", "tiny-shared-content", "tiny-stacking", "tiny-attention"]
NUM_SAMPLES, NUM_FRAMES = 3, 2


@pytest.mark.parametrize("preset", ROWS)
def test_predictions_and_gradients_equal_those_of_one_window_at_a_time(preset):
    model = _model(preset)
    one_by_one = [model.detect(*each) for each in _inputs(model)]
    expected = _gradients(model, one_by_one)
    together = detect_batch(model, _inputs(model))
    for alone, batched in zip(one_by_one, together, strict=True):
        for layer_alone, layer_batched in zip(alone, batched, strict=True):
            assert_close(layer_batched.class_logits.detach(), layer_alone.class_logits.detach(), 1e-5)
            assert_close(layer_batched.pose.detach(), layer_alone.pose.detach(), 1e-4)
    for name, gradient in _gradients(model, together).items():
        assert_close(gradient, expected[name], 1e-4 * float(expected[name].abs().max() + 1e-6))


def test_the_windows_of_a_batch_differ():
    first, second, _ = (prediction[-1].class_logits for prediction in detect_batch(*_model_and_inputs("tiny")))
    assert (first - second).abs().max() > 1e-3


def _model(preset):
    return randomise(DuoSpaceNet(PRESETS[preset]).eval(), seed=3)


def _model_and_inputs(preset):
    model = _model(preset)
    return model, _inputs(model)


def _inputs(model):
    """The decoder's inputs of NUM_SAMPLES windows; a camera is lost in one of them."""
    return [decoder_inputs(model, _history(model, number)) for number in range(NUM_SAMPLES)]


def _history(model, number):
    return [
        EncodedFrame(frame, model.encode(frame.images, frame.image_T_ego, frame.camera_valid))
        for frame in reversed(_frames(number))
    ]


@cache
def _frames(number):
    config = PRESETS["tiny"]
    frames = SyntheticClips(0, NUM_FRAMES, config.voxels.size[:2]).frames(number)
    prepared = [make_training_frame(frame, config, preprocessing(config)) for frame in frames]
    if number == 1:
        prepared[-1].camera_valid[2] = False
    return prepared


def _gradients(model, predictions):
    """The gradients of a loss that depends on every number of every prediction."""
    losses = [layer.class_logits.sin().sum() + layer.pose.sin().sum() for sample in predictions for layer in sample]
    named = {name: parameter for name, parameter in model.named_parameters() if name.startswith("decoder")}
    gradients = torch.autograd.grad(torch.stack(losses).sum(), list(named.values()), allow_unused=True)
    return {name: gradient for name, gradient in zip(named, gradients, strict=True) if gradient is not None}
