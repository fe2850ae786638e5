"""The types of fields in JSON records, and the description of a wrong one."""

import json

import pytest

from duospacenet.runtime.errors import InputError
from duospacenet.runtime.json_record import FiniteFloat, JsonRecord, Name, PositiveFloat, PositiveInt, read_json


class Item(JsonRecord):
    number: FiniteFloat = 0.0
    count: PositiveInt = 1
    size: PositiveFloat = 1.0
    name: Name = ""


def read(path, value):
    path.write_text(json.dumps(value))
    return read_json(path, Item, InputError)


@pytest.mark.parametrize(
    ("field", "value"),
    [("number", -2.5), ("number", 3), ("count", 1), ("size", 1e-300), ("size", 2), ("name", "Zürich 1"), ("name", "")],
)
def test_a_value_of_the_declared_type_is_read(tmp_path, field, value):
    assert getattr(read(tmp_path / "item.json", {field: value}), field) == value


@pytest.mark.parametrize(
    ("field", "value"),
    [
        *(("number", value) for value in ("2.5", True, None, [1.0], "nan")),
        *(("count", value) for value in (0, -1, 1.0, "1", True, None)),
        *(("size", value) for value in (0, 0.0, -0.5, "1.0", True, None)),
        *(("name", value) for value in (3, None, "\x1b[2J", "a\nb")),
    ],
)
def test_a_value_of_another_type_is_refused_with_the_file_and_the_field(tmp_path, field, value):
    with pytest.raises(InputError, match=rf"item\.json: field {field}: .*; got "):
        read(tmp_path / "item.json", {field: value})


@pytest.mark.parametrize("field", ["number", "size"])
@pytest.mark.parametrize("value", [float("nan"), float("inf"), float("-inf")])
def test_numbers_that_are_not_finite_are_refused_in_python_too(field, value):
    """A JSON file cannot hold them. Records are also built in Python."""
    with pytest.raises(ValueError, match="finite"):
        Item(**{field: value})


def test_unknown_fields_are_refused_and_records_cannot_be_changed(tmp_path):
    with pytest.raises(InputError, match=r"field colour: .*"):
        read(tmp_path / "item.json", {"colour": 1})
    with pytest.raises(ValueError, match="frozen"):
        Item().count = 3


@pytest.mark.parametrize("value", [[], 3, "text", None])
def test_a_file_without_an_object_is_refused(tmp_path, value):
    with pytest.raises(InputError, match=r"item\.json: expected a JSON object; got "):
        read(tmp_path / "item.json", value)


def test_a_file_above_the_largest_size_is_refused(tmp_path):
    (tmp_path / "item.json").write_text("{}" + " " * 20)
    with pytest.raises(InputError, match="at most 10 bytes; got 22"):
        read_json(tmp_path / "item.json", Item, InputError, max_bytes=10)
