"""JSON files that are read value by value, in chunks of a few characters, against Python's json."""

import json

import numpy as np
import pytest

from duospacenet.data import json_stream
from duospacenet.data.json_stream import JsonStream
from duospacenet.runtime.errors import InputError

VALUES = {
    "a": 1,
    "b": [1.5e-7, -3, True, None, '} ] " \\ é 𝒫'],
    "": {"nested": {"deep": [{}, [], ""]}},
    'key with { and "': "x" * 50,
    "last": 123456,
}


def read(path) -> list[tuple[str, object]]:
    with JsonStream(path) as stream:
        pairs = [(key, stream.value()) for key in stream.members()]
        stream.check_end()
    return pairs


def written(path, text: str):
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.parametrize("chunk", [1, 2, 7, 10_000])
@pytest.mark.parametrize("indent", [None, 2])
@pytest.mark.parametrize("ascii_only", [True, False])
def test_values_are_those_of_python_for_any_size_of_chunk(tmp_path, monkeypatch, chunk, indent, ascii_only):
    monkeypatch.setattr(json_stream, "CHUNK_CHARACTERS", chunk)
    text = json.dumps(VALUES, indent=indent, ensure_ascii=ascii_only)
    assert read(written(tmp_path / "file.json", f" \n{text}\n")) == list(VALUES.items())


def test_objects_can_be_entered_and_keys_may_repeat(tmp_path):
    path = written(tmp_path / "file.json", '{"a": {"x": 1, "x": 2}, "b": {}, "a": {"y": [3]}}')
    with JsonStream(path) as stream:
        found = [(outer, inner, stream.value()) for outer in stream.members() for inner in stream.members()]
    assert found == [("a", "x", 1), ("a", "x", 2), ("a", "y", [3])]


def test_unknown_numbers_are_nan(tmp_path):
    ((_, values),) = read(written(tmp_path / "file.json", '{"v": [NaN, 1]}'))
    assert np.isnan(values[0])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "expected a JSON object; got the end of the file"),
        ("[1]", r"expected a JSON object; got '\[1\]'"),
        ('{"a": 1', "after the key 'a': expected a comma or a closing brace; got the end of the file"),
        ('{"a": [1, 2', "after the key 'a': expected valid JSON .*; got the end of the file"),
        ('{"a": [1, 2, }]}', r"after the key 'a': expected valid JSON .*; got '}\]}'"),
        ('{"a" 1}', "expected a colon after the key; got '1}'"),
        ('{"a": 1 "b": 2}', "expected a comma or a closing brace"),
        ('{"a": 1, b: 2}', "expected a key in double quotes; got 'b: 2}'"),
        ('{"a": 1,}', "expected a key in double quotes; got '}'"),
        ('{"a": {"x": 1, "x": 2}}', "after the key 'a': expected each key once in an object; got 'x' twice"),
        ('{"a": 1} {"b": 2}', "expected the end of the file; got '{\"b\": 2}'"),
        ('{"a": "\x01"}', "expected valid JSON"),
        ('{"a": ' + "[" * 100_000, "expected arrays and objects that are not nested so deeply"),
        ('{"a": ' + "1" * 5000 + "}", "expected numbers that can be read"),
    ],
)
def test_other_text_is_refused_with_its_place(tmp_path, text, message):
    with pytest.raises(InputError, match=rf"file\.json: .*{message}"):
        read(written(tmp_path / "file.json", text))


def test_an_invalid_value_is_refused_without_reading_the_rest_of_the_file(tmp_path, monkeypatch):
    monkeypatch.setattr(json_stream, "CHUNK_CHARACTERS", 100)
    path = written(tmp_path / "file.json", '{"a": [1, oops' + " " * 1_000_000)
    with JsonStream(path) as stream, pytest.raises(InputError, match="got 'oops"):
        next(stream.members())
        stream.value()
    assert len(stream._text) < 1000


def test_a_value_without_an_end_is_not_read_into_memory(tmp_path, monkeypatch):
    monkeypatch.setattr(json_stream, "CHUNK_CHARACTERS", 100)
    monkeypatch.setattr(json_stream, "MAX_VALUE_CHARACTERS", 1000)
    with pytest.raises(InputError, match="after the key 'a': expected"):
        read(written(tmp_path / "file.json", '{"a": "' + "x" * 100_000 + '"}'))


def test_text_that_is_not_utf_8_is_refused(tmp_path):
    (tmp_path / "file.json").write_bytes(b'{"a": "\xff"}')
    with pytest.raises(InputError, match=r"file\.json: expected UTF-8 text"):
        read(tmp_path / "file.json")


def test_a_folder_and_a_missing_file_are_refused(tmp_path):
    with pytest.raises(InputError, match="expected a regular file; got a folder"):
        JsonStream(tmp_path)
    with pytest.raises(InputError, match="expected a file; got no such file"):
        JsonStream(tmp_path / "missing.json")
