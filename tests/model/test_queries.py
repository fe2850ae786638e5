"""Duo space queries and the pose encoder."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from duospacenet.model.queries import DuoSpaceQueries, PoseEncoder, initial_poses
from tests.helpers import references
from tests.helpers.model_inputs import ASYMMETRIC, assert_close, random_poses, with_random_weights


def test_the_pose_encoder_equals_its_equation():
    encoder = with_random_weights(PoseEncoder(ASYMMETRIC))
    pose = random_poses(ASYMMETRIC, 20)
    # Positions are divided by the upper end of the range (40, 15 and 5 m), velocities by 10 m/s.
    unit = np.array([40, 15, 5, 1, 1, 1, 1, 1, 10, 10])
    expected = references.pose_encoder(references.weights_of(encoder), pose.double().numpy(), unit)
    assert_close(encoder(pose), expected)


def test_the_pose_encoder_encodes_each_frame_in_the_same_way():
    encoder = with_random_weights(PoseEncoder(ASYMMETRIC))
    moments = torch.stack([random_poses(ASYMMETRIC, 20, seed=s) for s in (1, 2)])
    together = encoder(moments)
    assert_close(together[1], encoder(moments[1]).detach(), 1e-6)


@pytest.mark.parametrize(
    ("kind", "channels"), [("duo", 64), ("shared_content", 32), ("unshared", 32), ("bev", 32), ("pv", 32)]
)
def test_queries_have_one_pose_and_a_content_embedding_per_space_or_one(kind, channels):
    queries = with_random_weights(DuoSpaceQueries(replace(ASYMMETRIC, queries=kind)))
    content, pose = queries()
    assert pose is queries.pose
    assert content is queries.content
    assert {name: tuple(p.shape) for name, p in queries.named_parameters()} == {
        "pose": (10, 10),
        "content": (10, channels),
    }


def test_initial_poses_cover_the_perception_range():
    """From -20 to 40 m along x and -35 to 15 m along y."""
    poses = torch.cat([initial_poses(ASYMMETRIC, torch.Generator().manual_seed(seed)) for seed in range(100)])
    lower, upper = poses.amin(dim=0), poses.amax(dim=0)
    torch.testing.assert_close(lower[:2], torch.tensor([-20.0, -35.0]), rtol=0, atol=1)
    torch.testing.assert_close(upper[:2], torch.tensor([40.0, 15.0]), rtol=0, atol=1)
    assert poses[:, 0].ge(-20).all()
    assert poses[:, 1].le(15).all()
    assert poses[:, 8:].eq(0).all()
    torch.testing.assert_close(poses[:, 6] ** 2 + poses[:, 7] ** 2, torch.ones(1000))
