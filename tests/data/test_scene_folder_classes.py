"""Class names, numbers of points and attributes of boxes in scene folders."""

import numpy as np
import pytest

from duospacenet.data.class_names import DETECTION_CLASSES
from duospacenet.data.scene_folder import SceneFolder
from duospacenet.data.scene_writer import write_scene
from duospacenet.runtime.errors import InputError
from tests.helpers.json_edits import deep_copy
from tests.helpers.scene_folders import EXAMPLE_SCENE, write_example_scene


def scene_with(folder, *boxes, **changes):
    """The example scene with these boxes, as (class, number of points), in each of its frames."""
    frames = deep_copy(EXAMPLE_SCENE["frames"])
    box = frames[1]["boxes"][0]
    for frame in frames:
        frame["boxes"] = [{**box, "class": name, "num_points": points} for name, points in boxes]
    return SceneFolder(write_example_scene(folder, frames=frames, **changes))


def test_names_and_numbers_of_points_are_read_with_the_mapping(tmp_path):
    source = scene_with(tmp_path, ("Car", 3), ("Van", None), class_mapping={"Car": "car", "Van": None})
    for ground_truth in (source.frame(1).ground_truth, source.ground_truth_without_maps(1)):
        assert ground_truth.classes == ("Car", "Van")
        assert ground_truth.num_points.tolist() == [3, -1]
        assert ground_truth.class_mapping == {"Car": "car", "Van": None}
    source.check_class_names(DETECTION_CLASSES)


def test_unknown_names_of_all_frames_are_listed_together(tmp_path):
    source = scene_with(tmp_path, ("Car", 3), ("Car", 1), ("car", 1), ("animal", 1))
    with pytest.raises(InputError, match=r'scene\.json: expected .*; got \'Car\' \(4 boxes\)\..*\{"Car": "car"\}'):
        source.check_class_names(DETECTION_CLASSES)
    source.check_class_names(("Car", "car"))


@pytest.mark.parametrize("points", [-1, 1.5, "3", 2**70])
def test_a_wrong_number_of_points_is_refused(tmp_path, points):
    with pytest.raises(InputError, match=r"field frames\.0\.boxes\.0\.num_points"):
        scene_with(tmp_path, ("car", points))


def test_a_written_scene_has_the_mapped_names_and_the_points(tmp_path):
    source = scene_with(
        tmp_path / "one", ("Car", 3), ("Van", 1), ("bus", None), class_mapping={"Car": "car", "Van": None}
    )
    write_scene(tmp_path / "two", source)
    again = SceneFolder(tmp_path / "two").frame(1).ground_truth
    assert again.classes == ("car", "bus")
    assert again.num_points.tolist() == [3, -1]
    np.testing.assert_array_equal(again.boxes, source.frame(1).ground_truth.boxes[[0, 2]])


def scene_with_attributes(folder, *attributes):
    """The example scene with a box for each attribute in each of its frames; ... stands for an absent field."""
    frames = deep_copy(EXAMPLE_SCENE["frames"])
    box = frames[1]["boxes"][0]
    for frame in frames:
        frame["boxes"] = [box if value is ... else {**box, "attribute": value} for value in attributes]
    return SceneFolder(write_example_scene(folder, frames=frames))


@pytest.mark.parametrize(
    ("written", "expected"),
    [
        (("vehicle.moving", "", None), ("vehicle.moving", "", "")),
        ((..., "vehicle.parked"), ("", "vehicle.parked")),
        (("",), ("",)),
        ((..., None), None),
        ((), ()),
    ],
)
def test_attributes_are_read_and_written(tmp_path, written, expected):
    source = scene_with_attributes(tmp_path / "one", *written)
    assert source.frame(1).ground_truth.attributes == expected
    assert source.ground_truth_without_maps(1).attributes == expected
    write_scene(tmp_path / "two", source)
    assert SceneFolder(tmp_path / "two").frame(1).ground_truth.attributes == expected


@pytest.mark.parametrize("attribute", [3, ["vehicle.moving"], "vehicle\n.moving"])
def test_a_wrong_attribute_is_refused(tmp_path, attribute):
    with pytest.raises(InputError, match=r"field frames\.0\.boxes\.0\.attribute"):
        scene_with_attributes(tmp_path, attribute)
