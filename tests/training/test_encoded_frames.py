"""Tests of encoded frames: the temporal window equals the runtime's, and only the newest frame gets a gradient."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from duospacenet.model import DuoSpaceNet, randomise
from duospacenet.model.window import Window
from duospacenet.runtime.bundle.temporal_window import TemporalWindow
from duospacenet.runtime.history import History, PastFrame
from duospacenet.runtime.preprocessing import prepare
from duospacenet.training.encoded_frames import EncodedFrame, decoder_inputs, make_window
from duospacenet.weights.input_contract import preprocessing
from tests.helpers.trainings import TINY, synthetic_frames, synthetic_training_frames

LIMITS = TemporalWindow(num_frames=4, nominal_time_delta_s=0.5, largest_time_delta_s=2.0, largest_speed_m_s=70.0)


@pytest.fixture(scope="module")
def frames():
    """Three frames of a clip, the newest first."""
    return synthetic_training_frames(1, 3)[::-1]


@pytest.fixture(scope="module")
def encoded(tiny_model, frames):
    with torch.no_grad():
        return [
            EncodedFrame(frame, tiny_model.encode(frame.images, frame.image_T_ego, frame.camera_valid))
            for frame in frames
        ]


def at(frame, x_m, y_m, yaw_rad, time_s):
    """The frame with this ego pose and time."""
    pose = torch.eye(4, dtype=torch.float64)
    cos, sin = math.cos(yaw_rad), math.sin(yaw_rad)
    pose[:2] = torch.tensor([[cos, -sin, 0, x_m], [sin, cos, 0, y_m]], dtype=torch.float64)
    return frame._replace(global_T_ego=pose, timestamp_s=torch.tensor(time_s, dtype=torch.float64))


# --- Window -------------------------------------------------------------------------------------------------------


def test_past_T_now_follows_from_two_poses(frames):
    """Now at (13, 4), heading along y. Half a second ago at (10, 4), heading along x. Seen from the past frame, the
    ego is now 3 m ahead and turned by 90 degrees.
    """
    now = at(frames[0], 13.0, 4.0, math.pi / 2, 1.5e9 + 0.5)
    past = at(frames[0], 10.0, 4.0, 0.0, 1.5e9)
    window = make_window([now, past])
    assert torch.equal(window.past_T_now[0], torch.eye(4))
    expected = [[0, -1, 0, 3], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
    np.testing.assert_allclose(window.past_T_now[1].numpy(), expected, atol=1e-6)
    assert window.time_delta_s.tolist() == [0, 0.5]


def test_a_motion_of_a_millimetre_is_kept_1000_km_from_the_map_origin(frames):
    now, past = (at(frames[0], 1e6 + x, 2e6, 0.3, time) for x, time in ((0.001, 0.5), (0.0, 0.0)))
    translation = make_window([now, past]).past_T_now[1, :3, 3]
    assert float(translation.norm()) == pytest.approx(0.001, rel=1e-3)


def test_the_window_equals_that_of_the_runtime_for_the_same_frames(frames):
    manifest = SimpleNamespace(window=LIMITS, memory=())
    history, now = History(manifest), None
    for frame in synthetic_frames(1, 3):
        history = history if now is None else history.after(now)
        now = PastFrame.of(frame, prepare(frame, preprocessing(TINY), TINY.num_cameras), {})
    tensors, ages_s = history.decoder_inputs(now, {})
    assert len(ages_s) == 2
    window = make_window(frames)._asdict()
    assert window.keys() == tensors.keys()
    assert np.abs(window["past_T_now"][2, :3, 3].numpy()).max() > 1
    for name, ours in window.items():
        expected = tensors[name].numpy()
        assert not expected[3:].any() or name == "past_T_now"  # the empty slot
        np.testing.assert_allclose(ours.numpy(), expected[:3], atol=1e-6, err_msg=name)


# --- Decoder inputs -----------------------------------------------------------------------------------------------


def test_a_short_window_predicts_the_same_as_a_full_window_with_empty_slots(tiny_model, encoded):
    """The empty slots hold the newest frame's values, which must not matter."""
    for num_frames in (1, 3):
        caches, window = decoder_inputs(tiny_model, encoded[:num_frames])
        empty = TINY.num_frames - num_frames
        padded = Window(
            *(torch.cat([field, field[:1].expand(empty, *field.shape[1:])]) for field in window[:3]),
            torch.tensor([True] * num_frames + [False] * empty),
            torch.cat([window.camera_valid, window.camera_valid[:1].expand(empty, -1)]),
        )
        with torch.no_grad():
            short = tiny_model.detect(caches, window)
            full = tiny_model.detect([*caches, *[caches[0]] * empty], padded)
        for one, other in zip(short, full, strict=True):
            torch.testing.assert_close(one.class_logits, other.class_logits, atol=1e-5, rtol=1e-5)
            torch.testing.assert_close(one.pose, other.pose, atol=1e-4, rtol=1e-5)


def test_past_frames_change_the_predictions(tiny_model, encoded):
    """Otherwise the test above would pass with any window."""
    with torch.no_grad():
        alone, with_past = (tiny_model.detect(*decoder_inputs(tiny_model, encoded[:count]))[-1] for count in (1, 3))
    assert (alone.class_logits - with_past.class_logits).abs().max() > 1e-3


def test_only_the_features_of_the_newest_frame_get_a_gradient(frames):
    model = randomise(DuoSpaceNet(TINY), 0)
    for parameter in model.image_encoder.parameters():
        parameter.requires_grad_(False)
    encoded = []
    for frame in frames[:2]:
        features = model.encode(frame.images, frame.image_T_ego, frame.camera_valid)
        pv = [level.detach().requires_grad_() for level in features.pv]
        encoded.append(EncodedFrame(frame, features._replace(pv=pv, bev=features.bev.detach().requires_grad_())))
    leaves = [[*one.features.pv, one.features.bev] for one in encoded]
    model.detect(*decoder_inputs(model, encoded))[-1].pose.sum().backward()
    assert all(leaf.grad is not None and leaf.grad.any() for leaf in leaves[0])
    assert all(leaf.grad is None for leaf in leaves[1])
    value = model.decoder.layers[0].cross_attention.pv.attention.deformable.value
    assert all(parameter.grad.any() for parameter in value.parameters())
