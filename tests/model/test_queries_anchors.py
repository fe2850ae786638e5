"""Anchors set x, y and z of the pose vectors, and no other number."""

import pytest
import torch

from duospacenet.model.queries import place_anchors, resize_anchors

CENTRES = torch.tensor([[1.0, 2.0, 3.0], [-4.0, 5.5, 0.25]], dtype=torch.float64)


def test_the_centres_become_x_y_z_and_the_other_numbers_do_not_change():
    pose = torch.arange(20.0).reshape(2, 10)
    place_anchors(torch.nn.Parameter(pose), CENTRES)
    assert pose[:, :3].tolist() == CENTRES.tolist()
    assert pose[:, 3:].tolist() == torch.arange(20.0).reshape(2, 10)[:, 3:].tolist()


def test_several_sets_of_poses_get_the_same_centres():
    pose = torch.zeros(2, 2, 10)
    place_anchors(pose, CENTRES)
    assert pose[0].equal(pose[1])
    assert pose[0, :, :3].tolist() == CENTRES.tolist()


@pytest.mark.parametrize("shape", [(3, 3), (2, 2), (2, 11), (6,)])
def test_centres_are_refused_unless_there_is_one_per_query(shape):
    pose = torch.zeros(2, 10)
    with pytest.raises(ValueError, match=r"one centre per query, shape \(2, 3\); got"):
        place_anchors(pose, torch.ones(shape))
    assert not pose.any()


def test_a_nan_is_refused():
    with pytest.raises(ValueError, match="finite metres"):
        place_anchors(torch.zeros(2, 10), torch.full((2, 3), torch.nan))


def test_resized_anchors_keep_their_other_numbers():
    pose = torch.arange(20.0).reshape(2, 10)
    resize_anchors(pose, torch.tensor([2.0, 4.5, 1.5], dtype=torch.float64))
    expected = torch.arange(20.0).reshape(2, 10)
    expected[:, 3:6] = torch.tensor([0.6931, 1.5041, 0.4055])  # logarithms
    torch.testing.assert_close(pose, expected, atol=1e-4, rtol=0)
