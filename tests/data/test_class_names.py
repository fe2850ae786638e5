"""The classes that annotated names stand for."""

from collections import Counter

import pytest

from duospacenet.data.class_names import (
    DETECTION_CLASSES,
    NUSCENES_CATEGORIES,
    UnknownClassError,
    count_unknown,
    find_class,
    unknown_names_error,
)

# The table of nuScenes' detection task, with one line per detection class. Source: the page of the detection task,
# nuscenes.org/object-detection, and docs/instructions_nuscenes.md of nuscenes-devkit for the 23 categories.
DETECTION_TABLE = """
barrier: movable_object.barrier
bicycle: vehicle.bicycle
bus: vehicle.bus.bendy vehicle.bus.rigid
car: vehicle.car
construction_vehicle: vehicle.construction
motorcycle: vehicle.motorcycle
pedestrian: human.pedestrian.adult human.pedestrian.child human.pedestrian.construction_worker
pedestrian: human.pedestrian.police_officer
traffic_cone: movable_object.trafficcone
trailer: vehicle.trailer
truck: vehicle.truck
void: animal human.pedestrian.personal_mobility human.pedestrian.stroller human.pedestrian.wheelchair
void: movable_object.debris movable_object.pushable_pullable static_object.bicycle_rack
void: vehicle.emergency.ambulance vehicle.emergency.police
"""


def test_the_categories_of_nuscenes_are_mapped_as_published():
    pairs = {}
    for line in DETECTION_TABLE.split("\n"):
        class_name, _, names = line.partition(": ")
        pairs |= dict.fromkeys(names.split(), None if class_name == "void" else class_name)
    assert len(pairs) == 23
    assert dict(NUSCENES_CATEGORIES) == pairs
    assert {name: find_class(name) for name in pairs} == pairs


@pytest.mark.parametrize(
    ("name", "classes", "class_mapping", "expected"),
    [
        ("car", DETECTION_CLASSES, {}, "car"),
        ("Car", ("Car", "Van"), {}, "Car"),  # a model may have its own classes
        ("vehicle.car", ("vehicle.car",), {}, "vehicle.car"),
        ("vehicle.car", ("truck",), {}, None),  # known, but not a class of this model
        ("car", ("truck",), {}, None),
        ("DontCare", DETECTION_CLASSES, {}, None),
        ("Car", DETECTION_CLASSES, {"Car": "car"}, "car"),
        ("Car", DETECTION_CLASSES, {"Car": "vehicle.truck"}, "truck"),
        ("Tram", DETECTION_CLASSES, {"Tram": None}, None),
        ("car", DETECTION_CLASSES, {"car": None}, None),  # the mapping comes first
        ("vehicle.car", DETECTION_CLASSES, {"vehicle.car": "bus"}, "bus"),
    ],
)
def test_a_name_is_mapped_or_left_out(name, classes, class_mapping, expected):
    assert find_class(name, classes, class_mapping) == expected


@pytest.mark.parametrize("name", ["Car", "Pedestrian", "vehicle.cars", "CAR", " car", "cyclist", "", "vehicle", "None"])
def test_a_name_of_another_data_set_or_with_a_typo_is_unknown(name):
    with pytest.raises(UnknownClassError):
        find_class(name)


def test_the_target_of_a_mapping_must_be_known_too():
    with pytest.raises(UnknownClassError):
        find_class("Car", class_mapping={"Car": "auto"})
    assert count_unknown(["Car", "Car", "car"], class_mapping={"Car": "auto"}) == Counter(Car=2)


def test_the_error_lists_names_with_counts_the_expected_names_and_the_remedy():
    message = str(unknown_names_error("a/scene.json", {"Car": 12, "Tram": 1}, ("car", "bus"), {"Tram": "tramway"}))
    assert message == (
        "a/scene.json: expected class names of the model (car, bus), or category names of nuScenes; got 'Car' (12 "
        "boxes), 'Tram' (1 box, class_mapping gives 'tramway'). Rename them, or add to scene.json: "
        '"class_mapping": {"Car": "car", "Tram": "CLASS"}. A value of null leaves the boxes out.'
    )


def test_the_error_lists_ten_names_at_most_and_no_control_characters():
    names = {f"name {number}": 1 for number in range(11)}
    assert "'name 9' (1 box), 1 more. Rename" in str(unknown_names_error("x", names, ("car",), {}))
    message = str(unknown_names_error("x", {"\x1b[2Jcar\ud800": 1}, ("car",), {}))
    assert message.isascii()
    assert message.isprintable()


def test_names_are_compared_once_per_distinct_name_and_counted():
    assert count_unknown(["Car", "car", "Car", "animal", "Van"]) == {"Car": 2, "Van": 1}
