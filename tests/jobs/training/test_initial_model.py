"""Tests of the model before its first step: the settings that decide its queries."""

import math
from dataclasses import replace

import numpy as np
import pytest

from duospacenet.jobs.training.initial_model import initial_model
from duospacenet.model import DuoSpaceNet, randomise
from duospacenet.training import Settings
from duospacenet.training.recipe import read_recipe
from duospacenet.weights import save_checkpoint
from tests.helpers.trainings import TINY, synthetic_frames


@pytest.fixture(scope="module")
def ground_truth():
    return [frame.ground_truth for frame in synthetic_frames(1, 4)]


def queries_of(settings, ground_truth):
    return initial_model(TINY, settings, iter(ground_truth), None, {}, lambda _: None).model.queries


def test_the_queries_of_the_papers_recipe_have_the_mean_size_and_xavier_content(ground_truth):
    queries = queries_of(read_recipe("paper"), ground_truth)
    boxes = np.concatenate([truth.boxes for truth in ground_truth])
    near = boxes[np.linalg.norm(boxes[:, :3], axis=1) <= 55]
    sizes = queries.pose[:, 3:6].exp().detach().numpy()
    np.testing.assert_allclose(sizes, np.broadcast_to(near[:, 3:6].mean(axis=0), sizes.shape), rtol=1e-5)
    assert queries.content.abs().max() <= math.sqrt(6 / (TINY.num_queries + TINY.channels))


def test_the_queries_of_the_recipe_for_a_cpu_have_the_size_of_a_car_and_normal_content(ground_truth):
    queries = queries_of(Settings(), ground_truth)
    assert queries.pose[0, 3:6].exp().tolist() == pytest.approx([2, 4.5, 1.7])
    assert queries.content.std().item() == pytest.approx(1, rel=0.05)


def test_the_size_does_not_change_the_positions_of_the_anchors(ground_truth):
    car, mean = (queries_of(replace(Settings(), anchor_size=size), ground_truth).pose for size in ("car", "mean"))
    assert car[:, :3].equal(mean[:, :3])
    assert not car[:, 3:6].allclose(mean[:, 3:6])


def test_frozen_random_weights_get_a_warning(ground_truth, tmp_path):
    def messages_of(settings, weights=None):
        messages = []
        initial_model(TINY, settings, iter(ground_truth), weights, {}, messages.append)
        return [message for message in messages if message.startswith("warning")]

    paper, stem_only = read_recipe("paper"), replace(Settings(), frozen_stages=1)
    (warning,) = messages_of(paper)
    assert "expected trained weights of the backbone" in warning
    assert messages_of(stem_only) != []
    (warning,) = messages_of(replace(Settings(), frozen_parts=("lifter",)))
    assert "expected trained weights of the lifter" in warning
    (warning,) = messages_of(replace(Settings(), norm_eval=True))
    assert "expected trained weights of the BatchNorm layers" in warning
    assert messages_of(Settings()) == []
    path = tmp_path / "tiny.safetensors"
    save_checkpoint(path, randomise(DuoSpaceNet(TINY), 0))
    assert messages_of(paper, path) == []
    assert messages_of(replace(Settings(), frozen_parts=("lifter", "queries"), norm_eval=True), path) == []
