"""The trainer reports Sparse4D's losses for a batch with the paper's recipe, in each decoder layer."""

from dataclasses import replace

import pytest

from duospacenet.model import DuoSpaceNet, randomise
from duospacenet.model.decoder import Prediction
from duospacenet.training import Trainer
from duospacenet.training.recipe import read_recipe
from tests.helpers.sparse4d_losses import sparse4d_losses
from tests.helpers.trainings import CPU, TINY, synthetic_training_frames


def test_the_losses_of_a_step_equal_those_of_sparse4d(monkeypatch):
    """Three frames with 5, 2 and 0 objects. About half of the best class scores are below 0.05.

    With many objects, two assignments can have the same cost, because an L1 distance is piecewise linear.
    """
    batch = [
        frame._replace(boxes=frame.boxes[:count], labels=frame.labels[:count])
        for count, (frame,) in zip((5, 2, 0), (synthetic_training_frames(seed, 1) for seed in (1, 2, 3)), strict=True)
    ]
    settings = replace(read_recipe("paper"), steps=4, epochs=None, batch_size=3, amp="off")
    trainer = Trainer(randomise(DuoSpaceNet(TINY), 3), settings, CPU)
    for layer in trainer.model.decoder.layers:
        layer.heads.classes[-1].bias.data.fill_(-4.7)
    calls = []
    detect = trainer.model.detect

    def recorded(caches, window):
        predictions = detect(caches, window)
        calls.append([Prediction(*(tensor.detach().clone() for tensor in layer)) for layer in predictions])
        return predictions

    monkeypatch.setattr(trainer.model, "detect", recorded)
    (step,) = trainer.train_on([[frame] for frame in batch])
    assert len(calls) == 3
    best = calls[0][0].class_logits.sigmoid().amax(dim=-1)
    assert 0.1 < (best > 0.05).float().mean() < 0.9
    for layer in range(TINY.num_layers):
        predicted = [(call[layer], frame.boxes, frame.labels) for call, frame in zip(calls, batch, strict=True)]
        expected = sparse4d_losses(predicted, settings, cone=TINY.classes.index("traffic_cone"))
        reported = step.losses[f"class_{layer}"], step.losses[f"box_{layer}"]
        assert reported == pytest.approx(expected, rel=1e-4)
        assert reported[1] > 0
