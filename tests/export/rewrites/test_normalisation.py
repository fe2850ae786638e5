"""The standard deviation and the colour order are folded into the first convolution."""

import pytest
import torch
from torch import nn

from duospacenet.export.rewrites.normalisation import fold_normalisation
from tests.helpers.model_inputs import assert_close
from tests.helpers.rewritten_models import CONFIGS, called_operators, model_of, outputs, outputs_of, rewritten_by


@pytest.mark.parametrize("name", ["tiny", "pv", "bgr", "VoVNet"])
def test_the_outputs_of_the_model_stay(name):
    rewritten = outputs(rewritten_by(fold_normalisation, name))
    for output, expected in outputs_of(name).items():
        # The roundings of all layers add up.
        assert_close(rewritten[output], expected, 5e-5)


@pytest.mark.parametrize("name", ["tiny", "bgr", "VoVNet"])
def test_the_image_features_stay(name):
    """Every pixel has its own value in every channel, and the borders are padded."""
    images = torch.randint(0, 256, (2, 64, 160, 3), dtype=torch.uint8, generator=torch.Generator().manual_seed(0))
    rewritten = rewritten_by(fold_normalisation, name)
    for level, expected in zip(rewritten.image_encoder(images), model_of(name).image_encoder(images), strict=True):
        assert_close(level, expected, 1e-5)


@pytest.mark.parametrize("name", ["tiny", "bgr", "VoVNet"])
def test_the_first_convolution_has_the_weights_of_bgr_pixels(name):
    """By hand: a weight is divided by the standard deviation of its channel. RGB channels are reversed."""
    image = CONFIGS[name].image
    order = [2, 1, 0] if image.colour_order == "rgb" else [0, 1, 2]
    before, after = (
        next(module for module in model.image_encoder.backbone.modules() if isinstance(module, nn.Conv2d)).weight
        for model in (model_of(name), rewritten_by(fold_normalisation, name))
    )
    for bgr, own in enumerate(order):
        torch.testing.assert_close(after[:, bgr], before[:, own] / image.std[own])
    mean = rewritten_by(fold_normalisation, name).image_encoder.normalisation.mean
    assert mean.flatten().tolist() == pytest.approx([image.mean[own] for own in order])


def test_the_images_are_neither_divided_nor_flipped():
    before = called_operators(model_of("tiny"))
    after = called_operators(rewritten_by(fold_normalisation, "tiny"))
    assert before["aten.flip.default"] - after["aten.flip.default"] == 3  # once per frame
    assert before["aten.div.Tensor"] - after["aten.div.Tensor"] == 3
    assert before["aten.convolution.default"] == after["aten.convolution.default"]
