"""The tables sample_annotation, instance, category, attribute and visibility: the annotated boxes of the frames."""

from array import array
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..class_names import NUSCENES_CATEGORIES
from .annotated_boxes import box_velocities, boxes_in_ego
from .frame_tables import Frames
from .index_records import BOX, CategorySummary
from .poses import Poses, check_poses, rigid_transforms, rotations_from_quaternions
from .table import NumberedRow, Table, dangling_error, repeated_error, row_error
from .table_records import AnnotationRow, InstanceRow, NamedRow, VisibilityRow
from .table_set import TableSet

NO_ATTRIBUTE = -1


class Annotations(NamedTuple):
    """The annotations of all frames, sorted by frame, then by their rows.

    categories: all rows of their table.
    attributes: names.
    frames: (A,) number of the frame of each annotation.
    boxes: (A,) array of BOX.
    """

    categories: list[CategorySummary]
    attributes: list[str]
    frames: NDArray[np.int64]
    boxes: NDArray


@dataclass
class _Columns:
    """The columns of the table sample_annotation, row by row. numbers: row numbers by token."""

    frames: array = field(default_factory=lambda: array("q"))
    categories: array = field(default_factory=lambda: array("i"))
    attributes: array = field(default_factory=lambda: array("i"))
    num_points: array = field(default_factory=lambda: array("q"))
    centres: array = field(default_factory=lambda: array("d"))
    sizes: array = field(default_factory=lambda: array("d"))
    rotations: array = field(default_factory=lambda: array("d"))
    previous: list[str] = field(default_factory=list)
    following: list[str] = field(default_factory=list)
    numbers: dict[str, int] = field(default_factory=dict)

    def token(self, row: int) -> str:
        """Return the token of a row. Slow; for errors."""
        return next(token for token, number in self.numbers.items() if number == row)


def read_annotations(tables: TableSet, frames: Frames, frame_poses: Poses) -> Annotations:
    """Raises InputError, naming the table, the row and the token."""
    categories, category_of_instance = _read_instances(tables)
    attribute_table = tables.open("attribute", NamedRow)
    attributes = attribute_table.by_token()
    attribute_names = [attribute_table.check_name(row, "name") for row in attributes.values()]
    path, columns = _read_columns(tables, frames, categories, category_of_instance, list(attributes))
    times_s = 1e-6 * frames.timestamps_us
    numbers = np.frombuffer(columns.frames, np.int64)
    centres = np.frombuffer(columns.centres, np.float64).reshape(-1, 3)
    rotations = np.frombuffer(columns.rotations, np.float64).reshape(-1, 4)
    check_poses(path, Poses(centres, rotations), lambda row: (row, columns.token(row)))
    previous = _neighbours(path, columns, "prev", columns.previous)
    following = _neighbours(path, columns, "next", columns.following)
    boxes = np.zeros(len(numbers), BOX)
    boxes["box"] = boxes_in_ego(
        centres,
        np.frombuffer(columns.sizes, np.float64).reshape(-1, 3),
        rotations_from_quaternions(rotations),
        box_velocities(centres, times_s[numbers], previous, following),
        rigid_transforms(frame_poses.translations, frame_poses.rotations)[numbers],
    )
    boxes["category"], boxes["attribute"] = columns.categories, columns.attributes
    boxes["num_points"] = columns.num_points
    order = np.argsort(numbers, kind="stable")
    return Annotations(categories, attribute_names, numbers[order], boxes[order])


def _read_instances(tables: TableSet) -> tuple[list[CategorySummary], dict[str, int]]:
    """Return the categories, and the category number of each instance by token."""
    table = tables.open("category", NamedRow)
    rows = table.by_token()
    categories = [CategorySummary(table.check_name(row, "name"), token, row.number) for token, row in rows.items()]
    numbers = {token: number for number, token in enumerate(rows)}
    instances = tables.open("instance", InstanceRow)
    found = {
        token: instances.find(instance, "category_token", numbers, "category")
        for token, instance in instances.by_token().items()
    }
    return categories, found


def _read_columns(
    tables: TableSet,
    frames: Frames,
    categories: list[CategorySummary],
    category_of_instance: dict[str, int],
    attributes: list[str],
) -> tuple[Path, _Columns]:
    visibilities = tables.open("visibility", VisibilityRow).by_token()
    attribute_numbers = {token: number for number, token in enumerate(attributes)}
    table = tables.open("sample_annotation", AnnotationRow)
    columns = _Columns()
    for numbered in tables.rows(table):
        number, row = numbered
        if (first := columns.numbers.setdefault(row.token, number)) != number:
            raise repeated_error(table.path, numbered.place, first)
        category = table.find(numbered, "instance_token", category_of_instance, "instance")
        if row.visibility_token:
            table.find(numbered, "visibility_token", visibilities, "visibility")
        columns.frames.append(table.find(numbered, "sample_token", frames.numbers, "sample"))
        columns.categories.append(category)
        columns.attributes.append(_attribute(table, numbered, categories[category].name, attribute_numbers))
        columns.num_points.append(row.num_lidar_pts + row.num_radar_pts)
        columns.centres.extend(row.translation)
        columns.sizes.extend(row.size)
        columns.rotations.extend(row.rotation)
        columns.previous.append(row.prev)
        columns.following.append(row.next)
    return table.path, columns


def _attribute(
    table: Table[AnnotationRow], numbered: NumberedRow[AnnotationRow], category: str, attributes: dict[str, int]
) -> int:
    """Return the number of the attribute of an annotation, or NO_ATTRIBUTE.

    As in nuscenes-devkit, an annotation of a detection class has at most one.
    """
    row = numbered.row
    for token in row.attribute_tokens:
        if token not in attributes:
            raise dangling_error(table.path, numbered.place, "attribute_tokens", token, "attribute")
    if len(row.attribute_tokens) > 1:
        if NUSCENES_CATEGORIES.get(category, category) is None:
            return NO_ATTRIBUTE
        raise row_error(table.path, numbered.place, f"expected at most one attribute; got {len(row.attribute_tokens)}")
    return attributes[row.attribute_tokens[0]] if row.attribute_tokens else NO_ATTRIBUTE


def _neighbours(path: Path, columns: _Columns, field_name: str, tokens: list[str]) -> NDArray[np.int64]:
    """Return the row numbers (A,) that the field names, -1 where it is empty."""
    numbers = columns.numbers
    rows = np.array([numbers.get(token, -2) if token else -1 for token in tokens], np.int64)
    dangling = np.flatnonzero(rows == -2)
    if len(dangling):
        number = int(dangling[0])
        raise dangling_error(path, (number, columns.token(number)), field_name, tokens[number], "sample_annotation")
    return rows
