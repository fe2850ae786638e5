"""Stateless alternatives compute what the bundle computes, from the same frames."""

from dataclasses import replace

import numpy as np
import pytest

from duospacenet.jobs.benchmarking.stateless_runners import StatelessRunner, TorchNetwork
from duospacenet.runtime.detections import sigmoid
from tests.helpers.streams import detect_all


class Recorded:
    """A network that records its outputs."""

    def __init__(self, network):
        self._network, self.outputs, self.inputs = network, {}, {}

    def __call__(self, inputs):
        self.inputs = inputs
        self.outputs = self._network(inputs)
        return dict(self.outputs)


@pytest.fixture
def network(tiny_model):
    return Recorded(TorchNetwork(tiny_model, threads=1, compiled=False))


def test_the_model_in_pytorch_finds_the_bundles_boxes(pipeline, network, frames):
    runner = StatelessRunner(pipeline.manifest, network)
    for number, expected in enumerate(detect_all(pipeline, frames[:5], maps=True)):
        stages = runner.step(frames[number])
        scores = np.sort(sigmoid(network.outputs["class_logits"]), axis=None)[::-1]
        np.testing.assert_allclose(scores[: len(expected)], expected.scores, atol=1e-3)
        np.testing.assert_allclose(network.outputs["boxes"][expected.queries], expected.boxes, atol=1e-3)
        for name, probabilities in expected.maps.items():
            np.testing.assert_allclose(sigmoid(network.outputs[name][0, 0]), probabilities, atol=1e-3)
        assert list(stages) == ["preprocess", "model", "postprocess"]
        assert network.inputs["frame_valid"].sum() == min(number + 1, 4)


def test_a_reset_empties_the_window(pipeline, network, frames):
    runner = StatelessRunner(pipeline.manifest, network)
    runner.step(frames[0])
    runner.step(frames[1])
    runner.reset()
    runner.step(frames[2])
    assert network.inputs["frame_valid"].tolist() == [True, False, False, False]
    assert not network.inputs["images"][1:].any()


def test_a_lost_camera_is_masked_in_its_frame(pipeline, network, frames):
    runner = StatelessRunner(pipeline.manifest, network)
    runner.step(replace(frames[0], images={**frames[0].images, "CAM_FRONT": None}))
    runner.step(frames[1])
    assert network.inputs["camera_valid"].sum(axis=1).tolist() == [6, 5, 0, 0]


def test_without_a_compiler_the_reason_is_one_line(tiny_model, monkeypatch):
    def fail(_):
        raise OSError("no compiler found\n\nSet SOME_VARIABLE=1 for more")

    monkeypatch.setattr("torch.compile", lambda _: fail)
    with pytest.raises(RuntimeError, match=r"C\+\+ compiler: OSError: no compiler found$"):
        TorchNetwork(tiny_model, threads=1, compiled=True)
