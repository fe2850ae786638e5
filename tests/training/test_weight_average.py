"""Tests of the moving average of the weights, with an average that is computed in a loop."""

import copy

import torch
from safetensors.torch import load_file

from duospacenet.training import TrainingFolder
from tests.helpers.trainings import new_trainer, record_with, settings_with, synthetic_training_frames


def test_the_average_equals_a_loop_over_the_weights_of_all_steps():
    """With decay 0.2 the first steps use a smaller one: 1/10, 2/11; then 3/12 exceeds 0.2."""
    trainer = new_trainer(settings_with(steps=4, ema_decay=0.2, learning_rate=1e-2, backbone_learning_rate=1e-2))
    expected: dict[str, torch.Tensor] = {}
    frames = synthetic_training_frames(1, 2)
    for decay in (0.0, 2 / 11, 0.2, 0.2):
        next(trainer.train_on([frames[:1]]))
        state = {name: tensor.clone() for name, tensor in trainer.model.state_dict().items()}
        expected = {
            name: decay * expected[name] + (1 - decay) * tensor if expected else tensor
            for name, tensor in state.items()
        }
    average = trainer.evaluated_model.state_dict()
    assert "image_encoder.backbone.layer1.0.bn1.running_var" in average  # statistics are averaged as well
    for name, tensor in expected.items():
        if name.endswith("num_batches_tracked"):  # a counter: the model's own
            assert average[name] == trainer.model.state_dict()[name]
        else:
            torch.testing.assert_close(average[name], tensor, rtol=1e-5, atol=1e-7)
    assert not torch.equal(average["queries.pose"], trainer.model.state_dict()["queries.pose"])


def test_the_average_does_not_change_the_training():
    plain, averaged = (new_trainer(settings_with(steps=2, ema_decay=decay)) for decay in (0.0, 0.9))
    frames = synthetic_training_frames(1, 2)
    assert list(plain.train_on([frames])) == list(averaged.train_on([frames]))
    assert plain.evaluated_model is plain.model


def test_the_averaged_model_is_in_evaluation_mode_and_has_no_gradients():
    trainer = new_trainer(settings_with(ema_decay=0.9))
    assert not trainer.evaluated_model.training
    assert not any(parameter.requires_grad for parameter in trainer.evaluated_model.parameters())
    assert trainer.model.training
    copy.deepcopy(trainer.evaluated_model)  # a validation evaluates a copy


def test_the_weights_file_has_the_average_and_the_checkpoint_has_both(tmp_path):
    settings = settings_with(ema_decay=0.9)
    trainer = new_trainer(settings)
    list(trainer.train_on([synthetic_training_frames(1, 2)]))
    TrainingFolder(tmp_path, record_with(settings)).save(trainer)
    weights = load_file(tmp_path / "weights.safetensors")
    torch.testing.assert_close(weights, dict(trainer.evaluated_model.state_dict()), rtol=0, atol=0)
    assert not torch.equal(weights["queries.pose"], trainer.model.queries.pose)
    restored = new_trainer(settings)
    TrainingFolder(tmp_path, record_with(settings)).load(restored)
    torch.testing.assert_close(restored.state_dict(), trainer.state_dict(), rtol=0, atol=0)
