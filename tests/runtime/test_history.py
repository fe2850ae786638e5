import weakref
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from duospacenet.runtime import Frame
from duospacenet.runtime.bundle.temporal_window import TemporalWindow
from duospacenet.runtime.errors import InputError
from duospacenet.runtime.geometry import rigid_transform, rotation_z
from duospacenet.runtime.history import History, PastFrame
from duospacenet.runtime.preprocessing import NetworkInputs
from duospacenet.runtime.session import to_tensors

LIMITS = TemporalWindow(num_frames=3, nominal_time_delta_s=0.5, largest_time_delta_s=2.0, largest_speed_m_s=70.0)
MANIFEST = SimpleNamespace(window=LIMITS, memory=("pv", "bev"))
EMPTY_MEMORY = to_tensors(pv=np.zeros(2, np.float32), bev=np.zeros(1, np.float32))


def frame_at(timestamp_s, x_m=0.0, yaw_rad=0.0, scene="s", y_m=0.0, z_m=0.0):
    return Frame({}, {}, rigid_transform(rotation_z(yaw_rad), [x_m, y_m, z_m]), timestamp_s, scene)


def past_frame(frame, number=0):
    """A past frame whose cached values and calibration contain `number`, so that it can be recognised."""
    inputs = NetworkInputs(
        images=np.zeros((2, 1, 1, 3), np.uint8),
        image_T_ego=np.full((2, 3, 4), number, np.float32),
        camera_valid=np.array([True, number % 2 == 0]),
    )
    memory = to_tensors(pv=np.full(2, number, np.float32), bev=np.full(1, -number, np.float32))
    return PastFrame.of(frame, inputs, memory)


def history_of(*frames):
    history = History(MANIFEST)
    for number, frame in enumerate(frames, start=1):
        history = history.after(past_frame(frame, number))
    return history


def as_arrays(inputs):
    return {name: value.numpy() for name, value in inputs.items()}


def test_an_empty_history_continues_with_any_frame():
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
        (frame_at(10.5, y_m=-35.1), "ego jump of 35.1 m in 0.50 s"),
        (frame_at(10.5, z_m=35.1), "ego jump of 35.1 m in 0.50 s"),
        (frame_at(10.5, x_m=20.3, y_m=20.3, z_m=-20.3), "ego jump of 35.2 m in 0.50 s"),
        (frame_at(10.5, x_m=20.2, y_m=20.2, z_m=-20.2), None),
        (frame_at(10.1, x_m=6.9), None),
        (frame_at(10.1, x_m=7.1), "ego jump of 7.1 m in 0.10 s"),
        (frame_at(10.001, x_m=0.08), "ego jump of 0.1 m in 0.00 s"),
        (frame_at(12.0, x_m=139.0), None),
        (frame_at(12.0, x_m=141.0), "ego jump of 141.0 m in 2.00 s"),
        (frame_at(10.5, yaw_rad=1.5), None),
        (frame_at(10.5, yaw_rad=-1.6), "ego turn of 92 degrees in 0.50 s"),
        (frame_at(10.1, yaw_rad=0.32), "ego turn of 18 degrees in 0.10 s"),
        (frame_at(10.5, scene="t"), "new scene 't' after 's'"),
        (frame_at(3.0, scene="t"), "new scene 't' after 's'"),
    ],
)
def test_a_new_scene_a_gap_or_a_jump_resets_the_history(frame, reason):
    assert history_of(frame_at(9.5), frame_at(10.0)).reset_reason(frame) == reason
    # The same far from the origin and a quarter turn to the left, which is exact in float64.
    far = rigid_transform([[0, -1, 0], [1, 0, 0], [0, 0, 1]], [4096.0, -512.0, 64.0])
    before, now = (replace(f, global_T_ego=far @ f.global_T_ego) for f in (frame_at(10.0), frame))
    assert history_of(frame_at(9.5), before).reset_reason(now) == reason


@pytest.mark.parametrize("timestamp_s", [10.0, 9.999999, 9.5, -10.0])
def test_a_time_stamp_that_does_not_advance_is_refused(timestamp_s):
    with pytest.raises(InputError, match=rf"timestamp_s: expected later than 10\.0 .* got {timestamp_s}"):
        history_of(frame_at(9.5), frame_at(10.0)).reset_reason(frame_at(timestamp_s))


def test_past_T_now_maps_points_to_the_ego_frame_of_the_past_frame():
    # The past ego was at the origin, heading along x. The current ego is 3 m farther, heading along y. A point 10 m
    # ahead of it is at (3, 10) in the global frame, which was the past ego frame.
    now = past_frame(frame_at(11.0, x_m=3.0, yaw_rad=np.pi / 2))
    inputs, _ = history_of(frame_at(10.0)).decoder_inputs(now, EMPTY_MEMORY)
    past_T_now = as_arrays(inputs)["past_T_now"]
    np.testing.assert_allclose(past_T_now[1] @ [10, 0, 0, 1], [3, 10, 0, 1], atol=1e-6)
    np.testing.assert_array_equal(past_T_now[0], np.eye(4))
    np.testing.assert_array_equal(past_T_now[2], np.eye(4))


def test_time_delta_s_is_the_age_of_each_frame():
    start_s = 1.7e9
    history = history_of(frame_at(start_s), frame_at(start_s + 0.25))
    inputs, _ = history.decoder_inputs(past_frame(frame_at(start_s + 0.75)), EMPTY_MEMORY)
    assert as_arrays(inputs)["time_delta_s"].tolist() == [0.0, 0.5, 0.75]


def test_each_slot_has_the_cached_values_and_calibration_of_its_own_frame():
    now = past_frame(frame_at(11.0), 7)
    inputs, ages_s = history_of(frame_at(10.0), frame_at(10.5)).decoder_inputs(now, EMPTY_MEMORY)
    values = as_arrays(inputs)
    assert len(ages_s) == 2
    assert values["frame_valid"].tolist() == [True, True, True]
    assert [values[f"slot{t}.pv"].tolist() for t in range(3)] == [[7, 7], [2, 2], [1, 1]]
    assert [values[f"slot{t}.bev"].tolist() for t in range(3)] == [[-7], [-2], [-1]]
    assert values["image_T_ego"][:, 0, 0, 0].tolist() == [7, 2, 1]
    assert values["camera_valid"].tolist() == [[True, False], [True, True], [True, False]]


def test_slots_without_a_frame_are_masked_and_get_the_empty_memory():
    inputs, ages_s = History(MANIFEST).decoder_inputs(past_frame(frame_at(11.0), 7), EMPTY_MEMORY)
    values = as_arrays(inputs)
    assert ages_s == ()
    assert values["frame_valid"].tolist() == [True, False, False]
    assert values["time_delta_s"].tolist() == [0, 0, 0]
    assert not values["camera_valid"][1:].any()
    assert not values["image_T_ego"][1:].any()
    assert inputs["slot1.pv"] is inputs["slot2.pv"] is EMPTY_MEMORY["pv"]
    dtypes = {name: values[name].dtype for name in ("image_T_ego", "past_T_now", "time_delta_s")}
    assert set(dtypes.values()) == {np.dtype(np.float32)}


def test_the_oldest_frame_leaves_a_full_window():
    history = history_of(*(frame_at(10.0 + 0.5 * k) for k in range(5)))
    inputs, ages_s = history.decoder_inputs(past_frame(frame_at(12.5), 6), EMPTY_MEMORY)
    assert len(ages_s) == 2
    assert [as_arrays(inputs)[f"slot{t}.pv"][0] for t in range(3)] == [6, 5, 4]


def test_frames_beyond_the_window_are_released():
    """Otherwise a long stream would hold the cached values of all its frames."""
    history, kept = History(MANIFEST), []
    for number in range(6):
        past = past_frame(frame_at(10.0 + 0.5 * number), number)
        kept.append(weakref.ref(past))
        history = history.after(past)
    del past
    assert [ref() is not None for ref in kept] == [False] * 4 + [True] * 2


def test_a_history_is_not_changed_by_adding_a_frame():
    history = history_of(frame_at(10.0))
    history.after(past_frame(frame_at(10.5), 5))
    inputs, ages_s = history.decoder_inputs(past_frame(frame_at(11.0), 6), EMPTY_MEMORY)
    assert ages_s == (1.0,)
    assert as_arrays(inputs)["slot1.pv"][0] == 1


def test_a_window_of_one_frame_has_no_past():
    manifest = SimpleNamespace(window=LIMITS.model_copy(update={"num_frames": 1}), memory=("pv", "bev"))
    history = History(manifest).after(past_frame(frame_at(10.0)))
    inputs, ages_s = history.decoder_inputs(past_frame(frame_at(10.5)), EMPTY_MEMORY)
    assert ages_s == ()
    assert as_arrays(inputs)["frame_valid"].tolist() == [True]


def test_a_past_frame_keeps_its_pose_if_the_caller_changes_the_array():
    frame = frame_at(10.0, x_m=3.0)
    past = past_frame(frame)
    frame.global_T_ego[:] = 0
    assert past.global_T_ego[0, 3] == 3.0


def test_the_pose_of_a_past_frame_is_made_rigid():
    """Poses are accepted with rounding errors. `inverse` transposes the rotation, so these would grow with the offset.

    Here both poses are stretched by 1e-4, 1 km from the origin. The point itself moves with the vehicle: without the
    correction, it would move by 2e-4 of 1 km.
    """
    stretched = [frame_at(10.0, x_m=1000.0, yaw_rad=0.4), frame_at(10.5, x_m=1003.0, yaw_rad=0.4)]
    for frame in stretched:
        frame.global_T_ego[:3, :3] *= 1.0001
    past, now = map(past_frame, stretched)
    np.testing.assert_allclose(past.global_T_ego[:3, :3], rotation_z(0.4), atol=1e-12)
    np.testing.assert_array_equal(past.global_T_ego[:3, 3], [1000.0, 0, 0])
    inputs, _ = History(MANIFEST).after(past).decoder_inputs(now, EMPTY_MEMORY)
    moved = [3.0 * np.cos(0.4), -3.0 * np.sin(0.4), 0.0]  # 3 m along the global x, in the axes of the past ego
    expected = rigid_transform(np.eye(3), moved)
    np.testing.assert_allclose(as_arrays(inputs)["past_T_now"][1], expected, atol=1e-6)


def test_relative_poses_and_times_do_not_depend_on_the_global_position_and_time():
    near = history_of(frame_at(10.0)).decoder_inputs(past_frame(frame_at(10.5, x_m=4.0, yaw_rad=0.1)), EMPTY_MEMORY)[0]
    offset, offset_s = rigid_transform(np.eye(3), [5e6, -5e6, 100]), 2.0**30
    frames = [frame_at(10.0), frame_at(10.5, x_m=4.0, yaw_rad=0.1)]
    before, now = (
        replace(f, global_T_ego=offset @ f.global_T_ego, timestamp_s=f.timestamp_s + offset_s) for f in frames
    )
    far = history_of(before).decoder_inputs(past_frame(now), EMPTY_MEMORY)[0]
    np.testing.assert_allclose(as_arrays(far)["past_T_now"], as_arrays(near)["past_T_now"], atol=1e-8)
    np.testing.assert_array_equal(as_arrays(far)["past_T_now"][0], np.eye(4))
    np.testing.assert_array_equal(as_arrays(far)["time_delta_s"], as_arrays(near)["time_delta_s"])


def test_a_float32_pose_is_made_rigid_in_float64():
    frame = frame_at(10.0, x_m=3.0, yaw_rad=0.4)
    rotation = past_frame(replace(frame, global_T_ego=frame.global_T_ego.astype(np.float32))).global_T_ego[:3, :3]
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), rtol=0, atol=1e-14)


def test_rounding_errors_of_a_pose_do_not_enlarge_the_turn():
    """A turn of 1.5705 rad in 0.5 s is below pi per second. A rotation that is 0.1 % too small made it seem above."""
    shrunken = rigid_transform(0.9991 * rotation_z(1.5705), [0, 0, 0])
    assert np.arccos((np.trace(shrunken[:3, :3]) - 1) / 2) > np.pi / 2
    frames = replace(frame_at(10.5), global_T_ego=shrunken), frame_at(10.5, yaw_rad=1.58)
    reasons = [history_of(frame_at(10.0)).reset_reason(frame) for frame in frames]
    assert reasons == [None, "ego turn of 91 degrees in 0.50 s"]
