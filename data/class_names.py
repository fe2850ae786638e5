"""Class names of ground truth: which class of the model an annotated name stands for.

The names of nuScenes' raw annotations are mapped as in `category_to_detection_name` of nuscenes-devkit 1.2.0
(nuscenes/eval/detection/utils.py). Nine of its 23 categories belong to no class of the detection benchmark.
"""

import difflib
import json
from collections import Counter
from collections.abc import Collection, Iterable, Mapping
from types import MappingProxyType

from ..runtime.errors import InputError
from .box_counts import number_of_boxes

NUSCENES_CATEGORIES: Mapping[str, str | None] = MappingProxyType(
    {
        "vehicle.car": "car",
        "vehicle.truck": "truck",
        "vehicle.construction": "construction_vehicle",
        "vehicle.bus.bendy": "bus",
        "vehicle.bus.rigid": "bus",
        "vehicle.trailer": "trailer",
        "movable_object.barrier": "barrier",
        "vehicle.motorcycle": "motorcycle",
        "vehicle.bicycle": "bicycle",
        "human.pedestrian.adult": "pedestrian",
        "human.pedestrian.child": "pedestrian",
        "human.pedestrian.construction_worker": "pedestrian",
        "human.pedestrian.police_officer": "pedestrian",
        "movable_object.trafficcone": "traffic_cone",
        "animal": None,
        "human.pedestrian.personal_mobility": None,
        "human.pedestrian.stroller": None,
        "human.pedestrian.wheelchair": None,
        "movable_object.debris": None,
        "movable_object.pushable_pullable": None,
        "static_object.bicycle_rack": None,
        "vehicle.emergency.ambulance": None,
        "vehicle.emergency.police": None,
    }
)
DETECTION_CLASSES = tuple(dict.fromkeys(name for name in NUSCENES_CATEGORIES.values() if name is not None))
BICYCLE_RACK = "static_object.bicycle_rack"
REGION_TO_IGNORE = "DontCare"  # KITTI's name for regions without single boxes
MAX_LISTED_NAMES = 10

_NO_MAPPING: Mapping[str, str | None] = MappingProxyType({})


class UnknownClassError(KeyError):
    """An annotated name that is neither a class of the model nor a name of nuScenes."""


def find_class(
    name: str, classes: Collection[str] = DETECTION_CLASSES, class_mapping: Mapping[str, str | None] = _NO_MAPPING
) -> str | None:
    """Return the class that an annotated name stands for, or None if boxes with this name are left out.

    classes: the classes of the model.
    class_mapping: classes by annotated name, which come before all other rules. None leaves out the boxes.

    Boxes are also left out if their name is known, but is not a class of the model: a class or a category of nuScenes,
    or KITTI's DontCare. Raises UnknownClassError for any other name.
    """
    target = class_mapping.get(name, name)
    if target is None or target in classes:
        return target
    if target in NUSCENES_CATEGORIES:
        category_class = NUSCENES_CATEGORIES[target]
        return category_class if category_class in classes else None
    if target in DETECTION_CLASSES or target == REGION_TO_IGNORE:
        return None
    raise UnknownClassError(name)


def count_unknown(
    names: Iterable[str],
    classes: Collection[str] = DETECTION_CLASSES,
    class_mapping: Mapping[str, str | None] = _NO_MAPPING,
) -> Counter[str]:
    """Return the number of boxes by annotated name, of the names that `find_class` does not know.

    names: the name of each box.
    """
    unknown = Counter[str]()
    for name, count in Counter(names).items():
        try:
            find_class(name, classes, class_mapping)
        except UnknownClassError:
            unknown[name] = count
    return unknown


def unknown_names_error(
    place: str, unknown: Mapping[str, int], classes: Collection[str], class_mapping: Mapping[str, str | None]
) -> InputError:
    """Return the error for annotated names that `find_class` does not know.

    place: where the boxes are, for example a file.
    unknown: number of boxes by name.
    """
    listed = list(unknown)[:MAX_LISTED_NAMES]
    names = [_describe(name, unknown[name], class_mapping) for name in listed]
    if len(unknown) > len(listed):
        names.append(f"{len(unknown) - len(listed)} more")
    suggestion = json.dumps({name: _similar_class(name, classes) or "CLASS" for name in listed})
    return InputError(
        f"{place}: expected class names of the model ({', '.join(classes)}), or category names of nuScenes; got "
        f'{", ".join(names)}. Rename them, or add to scene.json: "class_mapping": {suggestion}. A value of null '
        "leaves the boxes out."
    )


def _describe(name: str, count: int, class_mapping: Mapping[str, str | None]) -> str:
    target = f", class_mapping gives {class_mapping[name]!r}" if name in class_mapping else ""
    return f"{name!r} ({number_of_boxes(count)}{target})"


def _similar_class(name: str, classes: Collection[str]) -> str | None:
    """Return the class with almost the same spelling, or None."""
    spelling = name.strip().lower().replace(" ", "_").replace("-", "_")
    matches = difflib.get_close_matches(spelling, list(classes), n=1, cutoff=0.8)
    return matches[0] if matches else None
