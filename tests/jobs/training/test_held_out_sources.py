"""The sources that a model in training is validated on: what is evaluated, refused and warned about."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from duospacenet.data.scene_writer import write_scene
from duospacenet.jobs.scoring import evaluate_bundle
from duospacenet.jobs.sources import open_source
from duospacenet.jobs.training.held_out_sources import HeldOutSources, check_validation_options
from duospacenet.runtime.errors import InputError, UsageError
from duospacenet.runtime.frame import GroundTruth
from duospacenet.runtime.progress import no_progress
from duospacenet.training.watching.validation_scores import ValidationScores
from tests.helpers.trainings import TINY, settings_with, synthetic_frames


def held_out(names, config=TINY, **settings):
    return HeldOutSources(names, config, settings_with(**settings), no_progress)


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    """A scene folder of two frames with small images."""
    return scene_of(tmp_path_factory.mktemp("scenes") / "scene", *synthetic_frames(1, 2))


def scene_of(folder, *frames):
    write_scene(folder, frames)
    return folder


def with_truth(frame, truth):
    return replace(frame, ground_truth=truth)


def without_maps(frame):
    return with_truth(frame, replace(frame.ground_truth, maps={}))


def without_boxes(frame):
    return with_truth(frame, GroundTruth(np.zeros((0, 9)), (), frame.ground_truth.maps, has_boxes=False))


# --- Scores -------------------------------------------------------------------------------------------------------


def test_the_scores_are_those_of_the_bundle_of_the_same_weights(tiny_bundle, tiny_model, scene, tmp_path):
    """`eval` runs the exported graphs with onnxruntime."""
    sources = [scene, scene_of(tmp_path / "other", *synthetic_frames(2, 2))]
    expected = evaluate_bundle(tiny_bundle, sources).report
    report = held_out(sources).evaluate(tiny_model, no_progress)
    assert report.num_samples == expected.num_samples == 4
    assert report.nds == pytest.approx(expected.nds, abs=1e-3)
    assert report.mean_average_precision == pytest.approx(expected.mean_average_precision, abs=1e-3)
    assert report.map_iou == pytest.approx(expected.map_iou, abs=1e-3)


def test_the_random_numbers_of_the_training_are_left_unchanged(tiny_model, scene):
    state = torch.get_rng_state()
    held_out(scene).evaluate(tiny_model, no_progress)
    assert torch.equal(torch.get_rng_state(), state)


@pytest.mark.parametrize(
    ("settings", "boxes", "maps"),
    [({}, True, True), ({"tasks": "detection"}, True, False), ({"tasks": "maps"}, False, True)],
)
def test_only_the_tasks_that_are_trained_are_evaluated(tiny_model, scene, settings, boxes, maps):
    sources = held_out(scene, **settings)
    scores = ValidationScores.of_report(1, "d", sources.evaluate(tiny_model, no_progress))
    assert (scores.nds is not None, bool(scores.map_iou)) == (boxes, maps)
    assert ("detection" in sources.identity, "maps" in sources.identity) == (boxes, maps)


def test_sources_with_boxes_alone_and_with_maps_alone_complement_each_other(tiny_model, tmp_path):
    frame = synthetic_frames(1, 1)[0]
    boxes, maps = scene_of(tmp_path / "boxes", without_maps(frame)), scene_of(tmp_path / "maps", without_boxes(frame))
    both = ValidationScores.of_report(1, "d", held_out([boxes, maps]).evaluate(tiny_model, no_progress))
    assert both.nds is not None
    assert set(both.map_iou) == set(TINY.map_classes)
    maps_alone = ValidationScores.of_report(1, "d", held_out(maps).evaluate(tiny_model, no_progress))
    assert maps_alone.nds is None
    assert maps_alone.quality.name == "mean map IoU"


# --- Refused ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("remove", "tasks", "expected"),
    [
        (without_boxes, "detection", "true boxes"),
        (without_maps, "maps", "true masks"),
        (lambda frame: with_truth(frame, None), "both", "true boxes or true masks"),
    ],
)
def test_a_source_without_ground_truth_of_the_trained_tasks_is_refused(tmp_path, remove, tasks, expected):
    scene = scene_of(tmp_path / "scene", remove(synthetic_frames(1, 1)[0]))
    with pytest.raises(InputError, match=rf"scene: --validation: expected {expected} in at least one frame; got none"):
        held_out(scene, tasks=tasks)


def test_masks_of_other_map_classes_alone_are_refused(tmp_path, tiny_model):
    frame = without_boxes(synthetic_frames(1, 1)[0])
    mask = frame.ground_truth.maps["drivable_area"]
    scene = scene_of(tmp_path / "scene", with_truth(frame, replace(frame.ground_truth, maps={"walkway": mask})))
    with pytest.raises(InputError, match=r"expected true boxes, or true masks of the model's map classes"):
        held_out(scene).evaluate(tiny_model, no_progress)


def test_unknown_class_names_are_refused_before_the_training(tmp_path):
    frame = synthetic_frames(1, 1)[0]
    names = ("Car",) * len(frame.ground_truth.classes)
    scene = scene_of(tmp_path / "scene", with_truth(frame, replace(frame.ground_truth, classes=names)))
    with pytest.raises(InputError, match=r"got 'Car'"):
        held_out(scene)


def test_a_first_frame_that_the_model_cannot_process_is_refused_before_the_training(tmp_path):
    frame = synthetic_frames(1, 1)[0]
    cameras = {**frame.cameras, "CAM_ROOF": frame.cameras["CAM_FRONT"]}
    images = {**frame.images, "CAM_ROOF": frame.images["CAM_FRONT"]}
    scene = scene_of(tmp_path / "scene", replace(frame, cameras=cameras, images=images))
    with pytest.raises(InputError, match=r"scene: --validation: frame synthetic-1-000000: cameras: expected 1 to 6"):
        held_out(scene)


def test_a_missing_source_is_refused(tmp_path):
    with pytest.raises(InputError, match="missing"):
        held_out(tmp_path / "missing")


def test_a_model_with_classes_of_its_own_is_only_validated_on_maps():
    config = replace(TINY, classes=("car", "tram"))
    with pytest.raises(UsageError, match=r"--validation: expected a model with classes of nuScenes' .* got 'tram'"):
        held_out("synthetic:11:1", config)
    assert "maps" in held_out("synthetic:11:1", config, tasks="maps").identity


def test_a_model_without_map_classes_is_validated_on_boxes():
    assert "maps" not in held_out("synthetic:11:1", replace(TINY, map_classes=())).identity


@pytest.mark.parametrize(
    ("validation", "validate_every", "settings", "message"),
    [
        (None, 10, {}, "--validate-every: expected only with --validation SOURCE"),
        ("synthetic:1", 0, {}, "--validate-every: expected at least 1 step; got 0"),
        ("synthetic:1", None, {"pretraining": True}, "--validation: expected a training of the whole model"),
    ],
)
def test_options_that_contradict_each_other_are_refused(validation, validate_every, settings, message):
    with pytest.raises(UsageError, match=message):
        check_validation_options(validation, validate_every, settings_with(**settings))


# --- Frames that are trained on as well ---------------------------------------------------------------------------


def overlap_warnings(trained, *names):
    messages = []
    held_out(names).warn_of_overlap(open_source(trained), messages.append)
    return messages


def test_held_out_frames_that_are_trained_on_are_warned_about(scene, tmp_path):
    longer = scene_of(tmp_path / "longer", *synthetic_frames(1, 3))
    (message,) = overlap_warnings(longer, scene, "synthetic:12:2")
    assert message == (
        "warning: --validation: 2 of 4 frames are trained on as well (synthetic-1-000000, synthetic-1-000001), so the "
        "scores are better than on other frames"
    )
    (message,) = overlap_warnings("synthetic:12:6", "synthetic:12:5")
    assert (
        "5 of 5 frames are trained on as well (synthetic-12-000000, synthetic-12-000001, synthetic-12-000002, ...)"
        in message
    )


def test_different_frames_with_equal_tokens_are_not_warned_about(tmp_path):
    """Many tools count the frames of each scene from 0."""
    first, second = (replace(synthetic_frames(seed, 1)[0], token="0", scene="drive") for seed in (1, 2))
    trained = scene_of(tmp_path / "trained", first)
    assert overlap_warnings(trained, scene_of(tmp_path / "other", second)) == []
    assert overlap_warnings("synthetic:12:2", "synthetic:13:2") == []
