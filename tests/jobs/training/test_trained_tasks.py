"""Trainings of one task alone, or of sources that lack ground truth: which parts of the model change, and are said to.

The learning rate and the weight decay are so large that a decay without a gradient would show.
"""

from dataclasses import replace

import numpy as np
import pytest
import torch
from safetensors import safe_open
from safetensors.torch import load_file

from duospacenet.cli.main import run_app
from duospacenet.data.scene_writer import write_scene
from duospacenet.jobs.training.training_job import train_model
from duospacenet.model import DuoSpaceNet, randomise
from duospacenet.model.presets import ablate
from duospacenet.weights import save_checkpoint
from tests.helpers.trainings import TINY, settings_with, synthetic_frames

STRONG = {"steps": 2, "learning_rate": 1e-2, "weight_decay": 0.5}
ALL = {"image_encoder", "lifter", "divergence_enhancement", "queries", "decoder", "segmentation"}


@pytest.fixture(scope="module")
def start(tmp_path_factory):
    """Random weights of the tiny model, without metadata."""
    path = tmp_path_factory.mktemp("start") / "start.safetensors"
    model = randomise(DuoSpaceNet(TINY), 0)
    for buffer in model.buffers():
        if not buffer.is_floating_point():
            buffer.fill_(1001)  # BatchNorm's counters after an earlier training
    save_checkpoint(path, model)
    return path


@pytest.fixture(scope="module")
def scenes(tmp_path_factory):
    """A scene with boxes only, and one with masks only."""
    folder, frames = tmp_path_factory.mktemp("scenes"), synthetic_frames(1, 2)
    unknown = {"boxes": np.zeros((0, 9)), "classes": (), "num_points": None, "attributes": None, "has_boxes": False}
    write_scene(folder / "boxes", [replace(f, ground_truth=replace(f.ground_truth, maps={})) for f in frames])
    write_scene(folder / "masks", [replace(f, ground_truth=replace(f.ground_truth, **unknown)) for f in frames])
    return {"boxes": str(folder / "boxes"), "masks": str(folder / "masks")}


def train(out, sources, start=None, config=TINY, **changes):
    settings = settings_with(**STRONG | changes)
    return train_model(config, settings, out, sources=sources, weights=start, device="cpu", workers=0).weights


def changed_parts(weights, start):
    """The parts of the model in which any tensor changed."""
    before, after = load_file(start), load_file(weights)
    assert before.keys() == after.keys()
    return {name.partition(".")[0] for name in before if not torch.equal(before[name], after[name])}


def metadata_of(weights):
    with safe_open(weights, "pt") as file:
        return file.metadata()


@pytest.mark.parametrize("history", ["stream", "windows"])
def test_boxes_alone_leave_the_map_segmentation_unchanged(tmp_path, scenes, start, history):
    weights = train(tmp_path / "out", scenes["boxes"], start, tasks="detection", history=history)
    assert changed_parts(weights, start) == ALL - {"segmentation"}


def test_boxes_alone_leave_the_bev_features_unchanged_if_no_loss_depends_on_them(tmp_path, scenes):
    """Nor are the statistics of their BatchNorm layers updated."""
    config, start = ablate(TINY, "pv"), tmp_path / "start.safetensors"
    save_checkpoint(start, randomise(DuoSpaceNet(config), 0))
    changes = {"tasks": "detection", "bev_supervision": False}
    weights = train(tmp_path / "out", scenes["boxes"], start, config, **changes)
    assert changed_parts(weights, start) == {"image_encoder", "queries", "decoder"}


@pytest.mark.parametrize("history", ["stream", "windows"])
def test_masks_alone_leave_the_queries_and_the_decoder_unchanged(tmp_path, scenes, start, history):
    weights = train(tmp_path / "out", scenes["masks"], start, tasks="maps", history=history)
    assert changed_parts(weights, start) == ALL - {"queries", "decoder"}


@pytest.mark.parametrize(
    ("frozen", "changes"),
    [
        *((({part}), {}) for part in sorted(ALL)),
        ({"image_encoder", "lifter", "divergence_enhancement"}, {"tasks": "maps", "history": "windows"}),
        ({"image_encoder", "queries"}, {"tasks": "detection", "ema_decay": 0.5}),
    ],
)
def test_frozen_parts_keep_every_tensor_and_all_other_parts_change(tmp_path, start, frozen, changes):
    settings = {"frozen_parts": tuple(frozen)} | changes
    weights = train(tmp_path / "out", None, start, **settings)
    without_loss = {"both": set(), "detection": {"segmentation"}, "maps": {"queries", "decoder"}}
    assert changed_parts(weights, start) == ALL - frozen - without_loss[settings.get("tasks", "both")]


def test_frozen_parts_with_random_weights_are_named_as_untrained(tmp_path):
    weights = train(tmp_path / "out", None, frozen_parts=("lifter",), steps=1)
    assert metadata_of(weights)["untrained"] == "lifter"


def test_a_source_with_boxes_and_one_with_masks_train_all_parts(tmp_path, scenes, start):
    """Two batches: one clip of each scene."""
    weights = train(tmp_path / "out", list(scenes.values()), start, steps=4)
    assert changed_parts(weights, start) == ALL
    assert metadata_of(weights)["trained"] == "true"


def test_the_weights_file_and_the_bundle_say_what_is_not_trained(tmp_path, scenes, capfd):
    """First maps alone, from random weights; then detection alone, from these weights. Then all parts are trained."""
    maps = train(tmp_path / "maps", scenes["masks"], tasks="maps", steps=1)
    assert {"trained": "false", "untrained": "queries, decoder", "anchors": "false"}.items() <= metadata_of(
        maps
    ).items()
    assert run_app(["export", "--weights", str(maps), "--dry-run"]) == 0
    assert "not trained: queries, decoder" in capfd.readouterr().out
    detection = train(tmp_path / "detection", scenes["boxes"], maps, tasks="detection", steps=1)
    assert metadata_of(detection)["trained"] == "true"
    assert "untrained" not in metadata_of(detection)


def test_queries_of_a_training_of_maps_alone_are_placed_at_anchors_later(tmp_path, scenes):
    maps = train(tmp_path / "maps", scenes["masks"], tasks="maps", steps=1)
    assert load_file(maps)["queries.pose"][:, 2].unique().tolist() == [1]  # all 1 m above the ground: no anchors
    small = {"learning_rate": 1e-9, "weight_decay": 0.0, "steps": 1}
    detection = train(tmp_path / "detection", scenes["boxes"], maps, tasks="detection", **small)
    assert load_file(detection)["queries.pose"][:, 2].std() > 0.1


def test_weights_of_unknown_origin_stay_unknown_where_they_are_not_trained(tmp_path, scenes, start):
    weights = train(tmp_path / "out", scenes["boxes"], start, tasks="detection", steps=1)
    assert metadata_of(weights)["trained"] == "unknown"
