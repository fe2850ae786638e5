"""Tests of the data of a training: what is trained on it, what is said about it, and which samples it has."""

import pickle
import re
from dataclasses import replace

import numpy as np
import pytest

from duospacenet.data.scene_writer import write_scene
from duospacenet.jobs.training.training_data import check_first_clip, open_training_data
from duospacenet.runtime.errors import InputError
from duospacenet.runtime.progress import no_progress
from duospacenet.training.tasks import Tasks, trained_tasks
from tests.helpers.nuscenes_roots import write_small_root
from tests.helpers.trainings import TINY, settings_with, synthetic_frames

NO_MAPS = replace(TINY, map_classes=())


def without_maps(frame):
    return replace(frame, ground_truth=replace(frame.ground_truth, maps={}))


def without_boxes(frame):
    unknown = {"boxes": np.zeros((0, 9)), "classes": (), "num_points": None, "attributes": None}
    return replace(frame, ground_truth=replace(frame.ground_truth, **unknown, has_boxes=False))


def without_any(frame):
    return replace(frame, ground_truth=None)


def unchanged(frame):
    return frame


@pytest.fixture
def write(tmp_path):
    """A function that writes a scene folder, with one function per frame that changes its ground truth."""

    def write_changed(name, *changes):
        frames = synthetic_frames(1, len(changes))
        write_scene(tmp_path / name, [change(frame) for change, frame in zip(changes, frames, strict=True)])
        return str(tmp_path / name)

    return write_changed


def open_data(sources, config=TINY, **changes):
    """The data, and the messages about it."""
    messages = []
    data = open_training_data(sources, settings_with(**changes), config, no_progress, messages.append)
    check_first_clip(data, config)
    return data, messages


def tasks_of(data, config=TINY):
    return trained_tasks(data.settings, config)


def newest_tokens(data):
    """The last digits of the tokens of an epoch's newest frames, sorted."""
    clips = data.clips
    return sorted(int(clips.frames(number)[-1].token[-6:]) for number in range(clips.samples_per_epoch))


# --- Tasks --------------------------------------------------------------------------------------------------------


def test_frames_with_boxes_and_frames_with_masks_are_trained_together(write):
    source = write("mixed", unchanged, without_maps, without_boxes, without_any)
    data, messages = open_data(source, history="windows", past_frames=0)
    assert tasks_of(data) == Tasks(detection=True, maps=True)
    assert newest_tokens(data) == [0, 1, 2]
    assert "ground truth: masks in 2 of 4 frames; the maps are trained on these only" in messages
    assert "ground truth: boxes in 2 of 4 frames; detection is trained on these only" in messages
    assert "an epoch has 3 training samples, in random order" in messages


@pytest.mark.parametrize(
    ("tasks", "message", "newest"),
    [
        ("detection", "tasks: detection only; the map segmentation is not trained", [0, 1]),
        ("maps", "tasks: maps only; the queries and the decoder are not trained", [0, 2]),
    ],
)
def test_one_task_alone_needs_the_ground_truth_of_this_task_only(write, tasks, message, newest):
    source = write("mixed", unchanged, without_maps, without_boxes, without_any)
    data, messages = open_data(source, tasks=tasks, history="windows", past_frames=0)
    assert tasks_of(data) == Tasks(detection=tasks == "detection", maps=tasks == "maps")
    assert newest_tokens(data) == newest
    assert message in messages
    assert [line for line in messages if "masks" in line and tasks == "detection"] == []
    assert [line for line in messages if "boxes" in line and tasks == "maps"] == []
    assert bool(list(data.anchor_truth)) == (tasks == "detection")


@pytest.mark.parametrize(
    ("remove", "message", "expected"),
    [
        (without_maps, "warning: no frame has true masks, so the maps are not trained", "detection"),
        (without_boxes, "warning: no frame has true boxes, so detection is not trained", "maps"),
    ],
)
def test_a_task_without_any_ground_truth_is_not_trained_and_the_settings_say_so(write, remove, message, expected):
    data, messages = open_data(write("scene", remove, remove))
    assert data.settings.tasks == expected
    assert message in messages


def test_each_source_needs_something_to_train_on_but_not_the_same(write):
    boxes, masks = write("boxes", without_maps, without_maps), write("masks", without_boxes)
    data, _ = open_data([boxes, masks], history="windows", past_frames=0)
    assert tasks_of(data) == Tasks(detection=True, maps=True)
    assert newest_tokens(data) == [0, 0, 1]
    data, _ = open_data([masks, boxes, masks], tasks="both", history="windows", past_frames=0)
    assert newest_tokens(data) == [0, 0, 0, 1]
    partly = write("partly", without_any, unchanged)
    assert newest_tokens(open_data([boxes, partly], history="windows", past_frames=0)[0]) == [0, 1, 1]
    with pytest.raises(InputError, match=re.escape(f"{masks}: expected ground-truth boxes in at least one frame")):
        open_data([boxes, masks], tasks="detection")


def test_masks_of_other_classes_are_no_ground_truth(write):
    def renamed(frame):
        (mask, *_) = frame.ground_truth.maps.values()
        return replace(frame, ground_truth=replace(without_boxes(frame).ground_truth, maps={"carpark": mask}))

    with pytest.raises(InputError, match="masks of drivable_area or lane_boundary in at least one frame; got none"):
        open_data(write("scene", renamed, renamed))
    data, _ = open_data(write("part", renamed, unchanged), history="windows", past_frames=0)
    assert newest_tokens(data) == [1]


def test_a_training_of_maps_alone_does_not_look_at_the_boxes(write):
    """Their class names may be unknown."""

    def strange(frame):
        truth = frame.ground_truth
        return replace(frame, ground_truth=replace(truth, classes=("Car",) * len(truth.classes)))

    source = write("scene", strange, strange)
    open_data(source, tasks="maps")
    with pytest.raises(InputError, match="got 'Car'"):
        open_data(source)


def test_a_model_without_map_classes_trains_detection(write):
    data, messages = open_data(write("scene", unchanged, without_maps), NO_MAPS)
    assert tasks_of(data, NO_MAPS) == Tasks(detection=True, maps=False)
    assert not [line for line in messages if "map" in line]


# --- Samples ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("changes", "largest"),
    [
        ({}, 4),
        ({"past_frames": 1}, 2),
        ({"past_frames": 0}, 1),
        ({"history_strides": (2,)}, 3),
        ({"tasks": "maps"}, 1),  # only the decoder uses past frames
        ({"pretraining": True}, 1),
    ],
)
def test_windows_have_as_many_past_frames_as_the_decoder_uses(write, changes, largest):
    """The window of tiny has 4 frames. In a scene of 5 frames, a stride of 2 leaves room for 3 of them."""
    data, _ = open_data(write("scene", *[unchanged] * 5), history="windows", **changes)
    assert max(len(data.clips.frames(number)) for number in range(5)) == largest


def test_class_balanced_sampling_is_said_with_the_number_of_samples(write):
    """Five frames with a car and one with a bus: three samples of each class."""

    def with_one(name):
        return lambda frame: replace(
            frame, ground_truth=replace(frame.ground_truth, boxes=frame.ground_truth.boxes[:1], classes=(name,))
        )

    source = write("scene", *[with_one("car")] * 5, with_one("bus"))
    data, messages = open_data(source, history="windows", past_frames=0, class_balanced=True, tasks="detection")
    assert "an epoch has 6 training samples, class-balanced" in messages
    assert newest_tokens(data).count(5) == 3


def test_sources_without_boxes_cannot_be_class_balanced(write):
    data, messages = open_data(write("masks", *[without_boxes] * 2), history="windows", class_balanced=True)
    assert not data.settings.class_balanced
    assert messages[-1] == "an epoch has 2 training samples, in random order"


def test_epochs_become_steps_of_whole_batches(write):
    source = write("scene", *[unchanged] * 5)
    data, _ = open_data(source, epochs=3, batch_size=2, history="windows")
    assert data.settings.steps == 3 * 3


def test_nuscenes_scene_folders_and_synthetic_drives_are_trained_together(write, tmp_path):
    root = write_small_root(tmp_path / "root", num_scenes=2, num_frames=3)
    sources = [f"nuscenes:{root}", write("scene", unchanged, unchanged), "synthetic:7:2"]
    data, messages = open_data(sources, history="windows", tasks="detection")
    assert data.clips.samples_per_epoch == 2 * 3 + 2 + 2
    assert [line for line in messages if re.fullmatch(r"ground truth: \d+ boxes in 10 frames to train on", line)]
    scenes = {data.clips.frames(number)[-1].scene for number in range(10)}
    assert len(scenes) == 4
    nuscenes, folder, drive = data.clips.identity.split(" + ")
    assert nuscenes.startswith("nuScenes v1.0-")
    assert folder.startswith("scene.json, sha256 ")
    assert drive.startswith("synthetic:7:2, split beyond 2 s")
    in_worker = pickle.loads(pickle.dumps(data.clips))  # as processes that load clips get it
    for number in range(10):
        one, other = data.clips.frames(number)[-1], in_worker.frames(number)[-1]
        assert (one.scene, one.token) == (other.scene, other.token)
        assert all(np.array_equal(image, other.images[name]) for name, image in one.images.items())


@pytest.mark.parametrize("history", ["stream", "windows"])
def test_synthetic_scenes_have_no_epochs(history):
    data, messages = open_data(None, history=history)
    assert data.clips.samples_per_epoch is None
    assert data.source is None
    assert not messages
