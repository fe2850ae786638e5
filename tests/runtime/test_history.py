from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from duospacenet.runtime import Frame
from duospacenet.runtime.bundle.manifest import TemporalWindow
from duospacenet.runtime.errors import InputError
from duospacenet.runtime.geometry import rigid, rotation_z
from duospacenet.runtime.history import History, PastFrame
from duospacenet.runtime.preprocessing import NetworkInputs
from duospacenet.runtime.session import tensors

LIMITS = TemporalWindow(num_frames=3, nominal_time_delta_s=0.5, largest_time_delta_s=2.0, largest_speed_m_s=70.0)
MANIFEST = SimpleNamespace(window=LIMITS, memory=("pv", "bev"))
NOTHING = tensors(pv=np.zeros(2, np.float32), bev=np.zeros(1, np.float32))


def frame_at(timestamp_s, x_m=0.0, yaw_rad=0.0, scene="s"):
    return Frame({}, {}, rigid(rotation_z(yaw_rad), [x_m, 0, 0]), timestamp_s, scene)


def moment_of(frame, number=0):
    """A moment whose memory and calibration hold a number to be known by."""
    inputs = NetworkInputs(
        images=np.zeros((2, 1, 1, 3), np.uint8),
        image_T_ego=np.full((2, 3, 4), number, np.float32),
        camera_valid=np.array([True, number % 2 == 0]),
    )
    memory = tensors(pv=np.full(2, number, np.float32), bev=np.full(1, -number, np.float32))
    return PastFrame.of(frame, inputs, memory)


def history_of(*frames):
    history = History(MANIFEST)
    for number, frame in enumerate(frames, start=1):
        history = history.after(moment_of(frame, number))
    return history


def arrays(bound):
    return {name: value.numpy() for name, value in bound.items()}


def test_an_empty_history_continues_with_anything():
    assert History(MANIFEST).reset_reason(frame_at(-5.0, x_m=1e9)) is None


@pytest.mark.parametrize(
    ("frame", "reason"),
    [
        (frame_at(10.5), None),
        (frame_at(12.0), None),
        (frame_at(12.01), "gap of 2.01 s, above 2 s"),
        (frame_at(10.5, x_m=35.0), None),
        (frame_at(10.5, x_m=-35.1), "ego jump of 35.1 m in 0.50 s"),
        (frame_at(11.0, x_m=69.0), None),
        (frame_at(10.5, scene="t"), "new scene 't' after 's'"),
        (frame_at(3.0, scene="t"), "new scene 't' after 's'"),
    ],
)
def test_a_history_ends_with_its_scene_or_in_a_gap_or_a_jump(frame, reason):
    assert history_of(frame_at(9.5), frame_at(10.0)).reset_reason(frame) == reason


@pytest.mark.parametrize("timestamp_s", [10.0, 9.999999, 9.5, -10.0])
def test_a_time_that_does_not_advance_is_refused(timestamp_s):
    with pytest.raises(InputError, match=rf"timestamp_s: expected later than 10\.0 .* got {timestamp_s}"):
        history_of(frame_at(9.5), frame_at(10.0)).reset_reason(frame_at(timestamp_s))


def test_the_window_says_where_each_frame_was_seen_from_now():
    # Then the ego stood at the origin and looked along x; a second later 3 m farther, looking along y. What is
    # 10 m ahead now is at (3, 10) in the world, and so it was for the ego then.
    now = moment_of(frame_at(11.0, x_m=3.0, yaw_rad=np.pi / 2))
    bound, _ = history_of(frame_at(10.0)).window(now, NOTHING)
    past_T_now = arrays(bound)["past_T_now"]
    np.testing.assert_allclose(past_T_now[1] @ [10, 0, 0, 1], [3, 10, 0, 1], atol=1e-6)
    np.testing.assert_allclose(past_T_now[0], np.eye(4), atol=1e-7)
    np.testing.assert_array_equal(past_T_now[2], np.eye(4))


def test_the_window_says_how_long_ago_each_frame_was():
    start_s = 1.7e9
    history = history_of(frame_at(start_s), frame_at(start_s + 0.25))
    bound, _ = history.window(moment_of(frame_at(start_s + 0.75)), NOTHING)
    assert arrays(bound)["time_delta_s"].tolist() == [0.0, 0.5, 0.75]


def test_the_window_holds_each_frames_own_memory_and_calibration():
    now = moment_of(frame_at(11.0), 7)
    bound, num_frames = history_of(frame_at(10.0), frame_at(10.5)).window(now, NOTHING)
    values = arrays(bound)
    assert num_frames == 3
    assert values["frame_valid"].tolist() == [True, True, True]
    assert [values[f"slot{t}.pv"].tolist() for t in range(3)] == [[7, 7], [2, 2], [1, 1]]
    assert [values[f"slot{t}.bev"].tolist() for t in range(3)] == [[-7], [-2], [-1]]
    assert values["image_T_ego"][:, 0, 0, 0].tolist() == [7, 2, 1]
    assert values["camera_valid"].tolist() == [[True, False], [True, True], [True, False]]


def test_slots_without_a_frame_are_masked_and_hold_nothing():
    bound, num_frames = History(MANIFEST).window(moment_of(frame_at(11.0), 7), NOTHING)
    values = arrays(bound)
    assert num_frames == 1
    assert values["frame_valid"].tolist() == [True, False, False]
    assert values["time_delta_s"].tolist() == [0, 0, 0]
    assert not values["camera_valid"][1:].any()
    assert not values["image_T_ego"][1:].any()
    assert bound["slot1.pv"] is bound["slot2.pv"] is NOTHING["pv"]
    dtypes = {name: values[name].dtype for name in ("image_T_ego", "past_T_now", "time_delta_s")}
    assert set(dtypes.values()) == {np.dtype(np.float32)}


def test_a_history_forgets_the_oldest_frame():
    history = history_of(*(frame_at(10.0 + 0.5 * k) for k in range(5)))
    bound, num_frames = history.window(moment_of(frame_at(12.5), 6), NOTHING)
    assert num_frames == 3
    assert [arrays(bound)[f"slot{t}.pv"][0] for t in range(3)] == [6, 5, 4]


def test_a_history_is_not_changed_by_what_comes_after():
    history = history_of(frame_at(10.0))
    history.after(moment_of(frame_at(10.5), 5))
    bound, num_frames = history.window(moment_of(frame_at(11.0), 6), NOTHING)
    assert num_frames == 2
    assert arrays(bound)["slot1.pv"][0] == 1


def test_a_window_of_one_frame_has_no_past():
    alone = SimpleNamespace(window=LIMITS.model_copy(update={"num_frames": 1}), memory=("pv", "bev"))
    history = History(alone).after(moment_of(frame_at(10.0)))
    bound, num_frames = history.window(moment_of(frame_at(10.5)), NOTHING)
    assert num_frames == 1
    assert arrays(bound)["frame_valid"].tolist() == [True]


def test_a_moment_keeps_the_pose_that_it_was_given():
    frame = frame_at(10.0, x_m=3.0)
    moment = moment_of(frame)
    frame.global_T_ego[:] = 0
    assert moment.global_T_ego[0, 3] == 3.0


def test_far_from_the_origin_and_late_the_differences_are_the_same():
    near = history_of(frame_at(10.0)).window(moment_of(frame_at(10.5, x_m=4.0, yaw_rad=0.1)), NOTHING)[0]
    there, then = rigid(np.eye(3), [5e6, -5e6, 100]), 2.0**30
    frames = [frame_at(10.0), frame_at(10.5, x_m=4.0, yaw_rad=0.1)]
    before, now = (replace(f, global_T_ego=there @ f.global_T_ego, timestamp_s=f.timestamp_s + then) for f in frames)
    far = history_of(before).window(moment_of(now), NOTHING)[0]
    np.testing.assert_allclose(arrays(far)["past_T_now"], arrays(near)["past_T_now"], atol=1e-8)
    np.testing.assert_array_equal(arrays(far)["time_delta_s"], arrays(near)["time_delta_s"])
