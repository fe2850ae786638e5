"""Tests of the initial queries: anchors from a file, of this toolkit and of Sparse4D."""

import json

import numpy as np
import pytest
import torch

from duospacenet.jobs.training.initial_model import initial_model
from duospacenet.model import DuoSpaceNet
from duospacenet.runtime.errors import ArtifactError, UsageError
from duospacenet.training import Settings
from duospacenet.weights import save_checkpoint
from duospacenet.weights.sparse4d_anchors import to_pose_vectors
from tests.helpers.trainings import TINY, synthetic_frames


def queries_from(anchors, **options):
    """The poses of the queries, and the messages. Without boxes, so nothing can be clustered."""
    messages = []
    settings = Settings(**{"anchor_size": "car", **options.pop("settings", {})})
    weights, truth = options.get("weights"), options.get("ground_truth", [])
    model, _ = initial_model(TINY, settings, truth, weights, {}, messages.append, anchors)
    return model.queries.pose.detach(), messages


def write_anchors_file(path, count):
    centres = [[float(i), -2.0, 0.5] for i in range(count)]
    content = {"schema_version": 1, "source": "s", "num_frames": 1, "num_boxes": 40, "range_m": 55.0, "seed": 0}
    path.write_text(json.dumps({**content, "centres_m": centres}))
    return path


def sparse4d_anchors(count=TINY.num_queries):
    generator = np.random.default_rng(0)
    return np.concatenate([generator.normal(0, 10, (count, 3)), generator.normal(0, 1, (count, 8))], axis=1)


def test_the_anchors_of_this_toolkit_are_positions_and_the_rest_is_that_of_a_car(tmp_path):
    pose, messages = queries_from(write_anchors_file(tmp_path / "anchors.json", TINY.num_queries))
    np.testing.assert_array_equal(pose[:, 0], np.arange(TINY.num_queries))
    assert pose[0, :3].tolist() == [0, -2, 0.5]
    assert pose[0, 3:6].exp().tolist() == pytest.approx([2, 4.5, 1.7])
    assert messages == [f"{tmp_path / 'anchors.json'}: {TINY.num_queries} anchors"]


def test_their_size_is_the_mean_size_of_the_boxes_if_the_recipe_says_so(tmp_path):
    truth = [frame.ground_truth for frame in synthetic_frames(1, 4)]
    file = write_anchors_file(tmp_path / "anchors.json", TINY.num_queries)
    pose, _ = queries_from(file, settings={"anchor_size": "mean"}, ground_truth=truth)
    boxes = np.concatenate([each.boxes for each in truth])
    near = boxes[np.linalg.norm(boxes[:, :3], axis=1) <= 55]
    np.testing.assert_allclose(pose[0, 3:6].exp(), near[:, 3:6].mean(axis=0), rtol=1e-5)
    assert pose[0, :3].tolist() == [0, -2, 0.5]


def test_without_boxes_they_keep_the_size_of_a_car(tmp_path):
    """As in a training of the maps alone."""
    file = write_anchors_file(tmp_path / "anchors.json", TINY.num_queries)
    pose, messages = queries_from(file, settings={"anchor_size": "mean", "tasks": "maps"})
    assert pose[0, 3:6].exp().tolist() == pytest.approx([2, 4.5, 1.7])
    assert messages[-1] == "anchors: no true box is near enough to give their size, so they have that of a car"


@pytest.mark.parametrize("name", ["nuscenes_kmeans900.npy", "sparse4d.pth"])
def test_sparse4ds_anchors_are_whole_poses(tmp_path, name):
    anchors, file = sparse4d_anchors(), tmp_path / name
    if file.suffix == ".npy":
        np.save(file, anchors)
    else:
        torch.save({"state_dict": {"head.instance_bank.anchor": torch.from_numpy(anchors)}}, file)
    pose, messages = queries_from(file, settings={"anchor_size": "mean"})
    np.testing.assert_allclose(pose, to_pose_vectors(anchors), rtol=1e-6, atol=1e-6)
    assert messages == [f"{file}: {TINY.num_queries} anchors of Sparse4D, moved from the lidar frame to the ego frame"]


@pytest.mark.parametrize("name", ["anchors.json", "anchors.npy"])
def test_another_number_of_anchors_is_refused(tmp_path, name):
    file = tmp_path / name
    if file.suffix == ".npy":
        np.save(file, sparse4d_anchors(31))
    else:
        write_anchors_file(file, 31)
    with pytest.raises(ArtifactError, match=rf"{name}: expected.* --queries {TINY.num_queries}"):
        queries_from(file)


@pytest.mark.parametrize("content", [None, b"", b"{", b"text"])
def test_a_file_that_is_missing_or_broken_is_refused_by_name(tmp_path, content):
    file = tmp_path / "anchors.json"
    if content is not None:
        file.write_bytes(content)
    with pytest.raises(ArtifactError, match=r"anchors\.json"):
        queries_from(file)
    with pytest.raises(ArtifactError, match=str(tmp_path)):
        queries_from(tmp_path)


def test_anchors_do_not_overwrite_trained_queries(tmp_path):
    save_checkpoint(tmp_path / "weights.safetensors", DuoSpaceNet(TINY), {"trained": "true"})
    file = write_anchors_file(tmp_path / "anchors.json", TINY.num_queries)
    with pytest.raises(UsageError, match=r"--anchors: expected weights without queries\.pose; .*weights\.safetensors"):
        queries_from(file, weights=tmp_path / "weights.safetensors")
