"""The past of a drive in training: the same window that the runtime makes, and a gradient for the present alone."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from duospacenet.model import DuoSpaceNet, randomise
from duospacenet.model.window import Window
from duospacenet.runtime.bundle.manifest import TemporalWindow
from duospacenet.runtime.history import PastFrame
from duospacenet.runtime.history import History
from duospacenet.runtime.preprocessing import prepare_inputs
from duospacenet.training.encoded_frames import EncodedFrame, decoder_inputs, make_window
from duospacenet.weights.input_contract import preprocessing
from tests.helpers.trainings import TINY, synthetic_frames, synthetic_training_frames

LIMITS = TemporalWindow(num_frames=4, nominal_time_delta_s=0.5, largest_time_delta_s=2.0, largest_speed_m_s=70.0)


@pytest.fixture(scope="module")
def samples():
    """Three frames of a drive, the newest first."""
    return synthetic_training_frames(1, 3)[::-1]


@pytest.fixture(scope="module")
def moments(tiny_model, samples):
    with torch.no_grad():
        return [
            EncodedFrame(sample, tiny_model.encode(sample.images, sample.image_T_ego, sample.camera_valid))
            for sample in samples
        ]


def placed(sample, x_m, y_m, yaw_rad, time_s):
    """The sample as from this place and time."""
    pose = torch.eye(4, dtype=torch.float64)
    cos, sin = math.cos(yaw_rad), math.sin(yaw_rad)
    pose[:2] = torch.tensor([[cos, -sin, 0, x_m], [sin, cos, 0, y_m]], dtype=torch.float64)
    return sample._replace(global_T_ego=pose, timestamp_s=torch.tensor(time_s, dtype=torch.float64))


def test_the_past_lies_where_two_poses_say_it_does(samples):
    """Now at (13, 4), looking along y; half a second ago at (10, 4), looking along x, so that now is 3 m ahead of it
    and turned by 90 degrees.
    """
    now = placed(samples[0], 13.0, 4.0, math.pi / 2, 1.5e9 + 0.5)
    past = placed(samples[0], 10.0, 4.0, 0.0, 1.5e9)
    window = make_window([now, past])
    assert torch.equal(window.past_T_now[0], torch.eye(4))
    expected = [[0, -1, 0, 3], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
    np.testing.assert_allclose(window.past_T_now[1].numpy(), expected, atol=1e-6)
    assert window.time_delta_s.tolist() == [0, 0.5]


def test_places_far_from_the_origin_of_the_map_keep_their_millimetres(samples):
    now, past = (placed(samples[0], 1e6 + x, 2e6, 0.3, time) for x, time in ((0.001, 0.5), (0.0, 0.0)))
    ahead = make_window([now, past]).past_T_now[1, :3, 3]
    assert float(ahead.norm()) == pytest.approx(0.001, rel=1e-3)


def test_the_window_is_the_one_that_the_runtime_makes_of_the_same_frames(samples):
    manifest = SimpleNamespace(window=LIMITS, memory=())
    history, now = History(manifest), None
    for frame in synthetic_frames(1, 3):
        history = history if now is None else history.after(now)
        now = PastFrame.of(frame, prepare_inputs(frame, preprocessing(TINY), TINY.num_cameras), {})
    bound, num_frames = history.window(now, {})
    assert num_frames == 3
    window = make_window(samples)._asdict()
    assert window.keys() == bound.keys()
    assert np.abs(window["past_T_now"][2, :3, 3].numpy()).max() > 1
    for name, ours in window.items():
        runtimes = bound[name].numpy()
        assert not runtimes[3:].any() or name == "past_T_now"  # the slot that is empty
        np.testing.assert_allclose(ours.numpy(), runtimes[:3], atol=1e-6, err_msg=name)


def test_fewer_frames_predict_the_same_as_a_full_window_with_empty_slots(tiny_model, moments):
    """What lies in an empty slot changes nothing: here it is the newest frame's memory and another place."""
    for num_frames in (1, 3):
        memory, window = decoder_inputs(tiny_model, moments[:num_frames])
        empty = TINY.num_frames - num_frames
        padded = Window(
            *(torch.cat([field, field[:1].expand(empty, *field.shape[1:])]) for field in window[:3]),
            torch.tensor([True] * num_frames + [False] * empty),
            torch.cat([window.camera_valid, window.camera_valid[:1].expand(empty, -1)]),
        )
        with torch.no_grad():
            short = tiny_model.detect(memory, window)
            full = tiny_model.detect([*memory, *[memory[0]] * empty], padded)
        for one, other in zip(short, full, strict=True):
            torch.testing.assert_close(one.class_logits, other.class_logits, atol=1e-5, rtol=1e-5)
            torch.testing.assert_close(one.pose, other.pose, atol=1e-4, rtol=1e-5)


def test_the_past_changes_what_is_predicted(tiny_model, moments):
    """Or the test above would say nothing."""
    with torch.no_grad():
        alone, with_past = (tiny_model.detect(*decoder_inputs(tiny_model, moments[:number]))[-1] for number in (1, 3))
    assert (alone.class_logits - with_past.class_logits).abs().max() > 1e-3


def test_a_gradient_goes_into_the_newest_features_alone(samples):
    model = randomise(DuoSpaceNet(TINY), 0)
    for parameter in model.image_encoder.parameters():
        parameter.requires_grad_(False)
    moments = []
    for sample in samples[:2]:
        features = model.encode(sample.images, sample.image_T_ego, sample.camera_valid)
        pv = [level.detach().requires_grad_() for level in features.pv]
        moments.append(EncodedFrame(sample, features._replace(pv=pv, bev=features.bev.detach().requires_grad_())))
    leaves = [[*moment.features.pv, moment.features.bev] for moment in moments]
    model.detect(*decoder_inputs(model, moments))[-1].pose.sum().backward()
    assert all(leaf.grad is not None and leaf.grad.any() for leaf in leaves[0])
    assert all(leaf.grad is None for leaf in leaves[1])
    value = model.decoder.layers[0].cross_attention.pv.attention.deformable.value
    assert all(parameter.grad.any() for parameter in value.parameters())
