"""Motion compensation and box conversion, against the paper's recursion, cases by hand, and the projection."""

import math

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from duospacenet.model.pose_vectors import compensate_motion, decode_boxes, encode_boxes
from duospacenet.model.projection import project
from tests.helpers import references
from tests.helpers.model_inputs import pinhole, rigid

WIDTH_PX, HEIGHT_PX = 160, 64

# No deadline, because the machine may be busy. Every run has the same examples.
repeatable = settings(deadline=None, derandomize=True, max_examples=200)

# --- Motion -------------------------------------------------------------------------------------------------------


def numbers(largest):
    largest = float(np.float32(largest))
    return st.floats(-largest, largest, width=32)


def pose_vectors():
    """Pose vectors (10) as float32 arrays."""
    spans = (50, 50, 5, 2, 2, 2)
    return st.tuples(*map(numbers, spans), numbers(math.pi), numbers(20), numbers(20)).map(
        lambda v: np.array([*v[:6], math.sin(v[6]), math.cos(v[6]), *v[7:]], dtype=np.float32)
    )


def steps(tilt):
    """Steps from a frame to the previous one: a rigid transform and the time [s]."""
    return st.tuples(
        st.builds(
            lambda yaw, pitch, roll, *place: rigid(yaw, pitch, roll, place),
            numbers(math.pi),
            numbers(tilt),
            numbers(tilt),
            numbers(20),
            numbers(20),
            numbers(2 if tilt else 0),
        ),
        st.floats(0.05, 1.0),
    )


def compensated(pose, past_T_now, time_delta_s):
    """`compensate_motion` of one pose (10), as (T, 10)."""
    result = compensate_motion(
        torch.tensor(pose)[None], torch.tensor(np.array(past_T_now)), torch.tensor(np.array(time_delta_s))
    )
    assert result.dtype == torch.float32
    return result[:, 0].numpy()


def composed(steps_back):
    """The arguments of `compensate_motion`: the transform from the current frame, and the age of each frame."""
    past_T_now, time_delta_s = [np.eye(4)], [0.0]
    for step, delta_s in steps_back:
        past_T_now.append(step @ past_T_now[-1])
        time_delta_s.append(time_delta_s[-1] + delta_s)
    return past_T_now, time_delta_s


@repeatable
@given(pose_vectors(), st.lists(steps(tilt=0), min_size=1, max_size=3))
def test_compensation_equals_the_papers_recursion_from_frame_to_frame_on_the_plane(pose, steps_back):
    expected = [pose.astype(np.float64)]
    for past_T_now, delta_s in steps_back:
        expected.append(references.step_back_on_the_plane(expected[-1], past_T_now, delta_s))
    np.testing.assert_allclose(compensated(pose, *composed(steps_back)), expected, rtol=1e-6, atol=1e-5)


@repeatable
@given(pose_vectors(), st.lists(steps(tilt=1.5), min_size=1, max_size=3))
def test_compensation_equals_the_papers_recursion_in_space(pose, steps_back):
    pose = pose.astype(np.float64)
    x, y, z, w, l, h, sin, cos, vx, vy = pose  # noqa: E741
    state = np.array([x, y, z]), np.array([cos, sin, 0]), np.array([vx, vy, 0])
    expected = [pose]
    for past_T_now, delta_s in steps_back:
        state = references.step_back_in_space(state, past_T_now, delta_s)
        position, heading, velocity = state
        expected.append(np.array([*position, w, l, h, heading[1], heading[0], *velocity[:2]]))
    actual = compensated(pose.astype(np.float32), *composed(steps_back))
    np.testing.assert_allclose(actual, expected, rtol=1e-6, atol=1e-5)


def test_compensation_equals_a_case_worked_by_hand():
    """The car drove 5 m and turned 90° to the left within 0.5 s. The current x axis is the y axis of the past frame. An
    object 10 m ahead that moves away at 4 m/s was 8 m ahead 0.5 s ago, that is, at y = 8 m in the past frame.
    """
    past_T_now = rigid(math.pi / 2, translation=(5, 0, 0))
    pose = np.array([10, 1, 0.5, 0.1, 0.2, 0.3, 0, 1, 4, 0], dtype=np.float32)
    expected = [5 - 1, 8, 0.5, 0.1, 0.2, 0.3, 1, 0, 0, 4]
    np.testing.assert_allclose(compensated(pose, [past_T_now], [0.5])[0], expected, atol=1e-6)


def test_a_pose_in_the_current_frame_is_unchanged_bit_for_bit():
    pose = np.random.default_rng(0).normal(0, 20, 10).astype(np.float32)
    assert np.array_equal(compensated(pose, [np.eye(4)], [0.0])[0], pose)


angle, place = numbers(math.pi), st.tuples(numbers(50), numbers(50), numbers(2))
ego_poses = st.builds(
    lambda yaw, pitch, roll, at: rigid(yaw, pitch, roll, at), angle, numbers(0.2), numbers(0.2), place
)


@repeatable
@given(
    global_T_now=ego_poses,
    global_T_past=ego_poses,
    ego_T_forward=st.builds(rigid, angle, numbers(0.2), numbers(0.2)),
    pixel=st.tuples(st.floats(5, 155), st.floats(5, 59)),
    depth_m=st.floats(2, 60),
    velocity=st.one_of(st.just((0.0, 0.0)), st.tuples(numbers(20), numbers(20))),
    age_s=st.floats(0, 2),
)
def test_a_compensated_pose_is_projected_to_the_pixel_where_the_past_camera_saw_the_object(
    global_T_now, global_T_past, ego_T_forward, pixel, depth_m, velocity, age_s
):
    """A past camera sees an object at a pixel. The object stands still or moves with constant velocity in the plane.
    Its current pose, moved back by compensation, must be projected to the same pixel.
    """
    image_T_past = pinhole(100, (80, 32), ego_T_forward)
    in_past = np.linalg.solve(image_T_past[:, :3], np.array([*pixel, 1]) * depth_m - image_T_past[:, 3])
    velocity_global = global_T_now[:3, :3] @ [*velocity, 0]
    in_global_now = (global_T_past @ [*in_past, 1])[:3] + age_s * velocity_global
    in_now = (np.linalg.inv(global_T_now) @ [*in_global_now, 1])[:3]
    pose = np.array([*in_now, 0, 0, 0, 0, 1, *velocity], dtype=np.float32)

    past = compensated(pose, [np.linalg.inv(global_T_past) @ global_T_now], [age_s])

    locations, visible = project(torch.tensor(past[:, :3]), torch.tensor(image_T_past)[None], WIDTH_PX, HEIGHT_PX)
    assert visible.all()
    np.testing.assert_allclose(locations[0, :, 0].numpy() * [WIDTH_PX, HEIGHT_PX], pixel, atol=0.01)


def test_a_broken_frame_does_not_change_the_others():
    """A masked slot of the window may hold any values."""
    pose = np.random.default_rng(0).normal(0, 20, 10).astype(np.float32)
    good = rigid(0.3, translation=(5, 1, 0))
    moments = compensated(pose, [np.eye(4), np.full((4, 4), np.nan), good], [0.0, np.nan, 1.0])
    assert np.array_equal(moments[[0, 2]], compensated(pose, [np.eye(4), good], [0.0, 1.0]))


# --- Boxes --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("sin", "cos", "yaw"),
    [
        (0, 1, 0),
        (1, 0, math.pi / 2),
        (0, -1, math.pi),
        (-1, 0, -math.pi / 2),
        (0.5, math.sqrt(3) / 2, math.pi / 6),
        (math.sqrt(3) / 2, -0.5, 2 * math.pi / 3),
        (-0.5, -math.sqrt(3) / 2, -5 * math.pi / 6),
        (-math.sqrt(3) / 2, 0.5, -math.pi / 3),
        (3, 3, math.pi / 4),  # not of length 1, as a network predicts it
    ],
)
def test_a_pose_vector_is_decoded_to_a_box_in_every_quadrant(sin, cos, yaw):
    pose = torch.tensor([1.0, -2.0, 3.0, 0.0, math.log(4.5), math.log(0.5), sin, cos, -6.0, 7.0])
    box = torch.tensor([1.0, -2.0, 3.0, 1.0, 4.5, 0.5, yaw, -6.0, 7.0])
    torch.testing.assert_close(decode_boxes(pose), box)


def test_a_box_is_encoded_as_a_pose_vector():
    box = torch.tensor([[1.0, -2.0, 3.0, 1.0, math.e, math.e**2, math.pi / 6, -6.0, 7.0]])
    pose = torch.tensor([[1.0, -2.0, 3.0, 0.0, 1.0, 2.0, 0.5, math.sqrt(3) / 2, -6.0, 7.0]])
    torch.testing.assert_close(encode_boxes(box), pose)


sizes = st.floats(0.125, 20, width=32)


@repeatable
@given(st.tuples(numbers(50), numbers(50), numbers(5), sizes, sizes, sizes, numbers(3), numbers(20), numbers(20)))
def test_decoding_inverts_encoding(values):
    box = torch.tensor([values])
    torch.testing.assert_close(decode_boxes(encode_boxes(box)), box, rtol=1e-5, atol=1e-5)
