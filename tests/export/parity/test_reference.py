"""The reference of the parity check gives the length of the heading vector of each box."""

import numpy as np
import pytest
import torch

from duospacenet.export.graphs import cached_names
from duospacenet.export.parity.random_inputs import RandomInputs
from duospacenet.export.parity.reference import EagerReference
from duospacenet.model import PRESETS, DuoSpaceNet, randomise
from duospacenet.runtime.parity.tensor_error import TensorError
from duospacenet.runtime.parity.tolerances import GRAPH_TOLERANCE

TINY = PRESETS["tiny"]


def runs_of_decoder(model):
    """The decoder in float32 and in float64 on the same random inputs."""
    reference = EagerReference(model)
    scales = dict.fromkeys(cached_names(TINY), 1.0)
    inputs = RandomInputs(model, scales, seed=0).sample(reference.graphs["decoder"], all_valid=True)
    single = reference.run("decoder", inputs)
    double = EagerReference(model.double())
    wide = {name: value.double() if value.dtype == torch.float32 else value for name, value in inputs.items()}
    return single, double.run("decoder", wide)


@pytest.fixture
def model():
    return randomise(DuoSpaceNet(TINY), 0).eval()


def test_the_heading_is_the_length_of_the_sine_and_cosine(model):
    single, _ = runs_of_decoder(model)
    yaw = single.outputs["boxes"][:, 6].double()
    assert single.heading.shape == (TINY.num_queries,)
    heads = model.float().decoder.layers[-1].heads
    poses = []
    heads.register_forward_hook(lambda _module, _inputs, prediction: poses.append(prediction.pose))
    EagerReference(model).run("decoder", single.inputs)
    sin, cos = poses[0].double()[:, 6:8].unbind(1)
    torch.testing.assert_close(single.heading.double(), (sin**2 + cos**2).sqrt(), rtol=1e-6, atol=0)
    torch.testing.assert_close(sin, single.heading.double() * yaw.sin(), rtol=1e-4, atol=1e-5)


def test_only_the_decoder_has_a_heading(model):
    reference = EagerReference(model)
    inputs = {name: torch.zeros(spec.shape) for name, spec in reference.graphs["segmenter"].inputs.items()}
    assert reference.run("segmenter", inputs).heading is None


def test_rounding_of_short_heading_vectors_is_within_the_tolerance(model):
    """The refinements of the layers cancel the vector (0, 1) up to 1e-4. Its angle is then mostly rounding."""
    with torch.no_grad():
        model.queries.pose[:, 6:8] = torch.tensor([0.0, 1.0])
        for layer in model.decoder.layers:
            head = layer.heads.refinement[-1]
            head.weight[6:8] *= 3e-5
            head.bias[6:8] = torch.tensor([0.0, -1 / TINY.num_layers])
    single, double = runs_of_decoder(model)
    boxes, expected = (run.outputs["boxes"].numpy() for run in (single, double))
    heading = double.heading.numpy()
    assert np.median(heading) < 1e-3
    assert TensorError.between_outputs("boxes", boxes, expected).relative > GRAPH_TOLERANCE
    assert TensorError.between_outputs("boxes", boxes, expected, heading=heading).relative < GRAPH_TOLERANCE / 2
