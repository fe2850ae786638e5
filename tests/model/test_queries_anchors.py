"""Anchors in the pose vectors: x, y, z and nothing else."""

import pytest
import torch

from duospacenet.model.queries import place_anchors

CENTRES = torch.tensor([[1.0, 2.0, 3.0], [-4.0, 5.5, 0.25]], dtype=torch.float64)


def test_the_centres_become_x_y_z_and_the_other_numbers_stay():
    pose = torch.arange(20.0).reshape(2, 10)
    place_anchors(torch.nn.Parameter(pose), CENTRES)
    assert pose[:, :3].tolist() == CENTRES.tolist()
    assert pose[:, 3:].tolist() == torch.arange(20.0).reshape(2, 10)[:, 3:].tolist()


def test_several_sets_of_poses_start_alike():
    pose = torch.zeros(2, 2, 10)
    place_anchors(pose, CENTRES)
    assert pose[0].equal(pose[1])
    assert pose[0, :, :3].tolist() == CENTRES.tolist()


@pytest.mark.parametrize("shape", [(3, 3), (2, 2), (2, 11), (6,)])
def test_anything_but_one_centre_a_query_is_refused(shape):
    pose = torch.zeros(2, 10)
    with pytest.raises(ValueError, match=r"one centre per query, shape \(2, 3\); got"):
        place_anchors(pose, torch.ones(shape))
    assert not pose.any()


def test_a_nan_is_refused():
    with pytest.raises(ValueError, match="finite metres"):
        place_anchors(torch.zeros(2, 10), torch.full((2, 3), torch.nan))
