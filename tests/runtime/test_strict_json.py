"""Strict JSON. Whatever is accepted equals the result of Python's parser."""

import json

import pytest

from duospacenet.runtime.strict_json import JsonError, parse_strict_json


def nested(depth):
    return "[" * depth + "1" + "]" * depth


@pytest.mark.parametrize(
    "text",
    [
        "{}",
        '{"a": {"a": [{"a": 1}, {"a": 2}]}, "b": {"a": 3}}',
        '["\\u00e9", "é", "\\ud83d\\ude97", "\\u001b[31m", "NaN", "Infinity"]',
        "[1e300, -1.7976931348623157e308, 1e-400, 18446744073709551615, 0.1234567890123456789]",
        " \n\t[true, null]\r\n",
        nested(500),
    ],
)
def test_strict_json_is_parsed_as_by_the_standard_parser(text):
    assert parse_strict_json(text.encode()) == json.loads(text)


@pytest.mark.parametrize(
    "text",
    [
        '{"a": 1, "b": 2, "a": 1}',
        '{"cameras": {"a": {}, "b": {}, "\\u0061": {}}}',
        '[[{"x": [{"a": 1, "a": 2}]}]]',
        '{"a": {"a": 1}, "a": {"a": 2}}',
    ],
)
def test_a_key_that_occurs_twice_is_refused_at_any_depth(text):
    with pytest.raises(JsonError, match="expected each key once in an object; got 'a' 2 times"):
        parse_strict_json(text.encode())


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('{"a": [0, NaN]}', r"field a\.1: expected a finite number .*; got nan"),
        ('{"a": {"b": Infinity}}', r"field a\.b: expected a finite number .*; got inf"),
        ("-Infinity", r"^expected a finite number .*; got -inf"),
        ('{"a": 1e400}', r"field a: expected a finite number .*; got inf"),
        ('{"a": -1E+999}', r"field a: expected a finite number .*; got -inf"),
        ('{"a": 18446744073709551616}', r"field a: expected an integer of at most 64 bits; got 20 digits"),
        ("-18446744073709551616", r"^expected an integer of at most 64 bits; got 20 digits"),
        ("9" * 4000, "expected an integer of at most 64 bits; got 4000 digits"),
        ("9" * 5000, "expected JSON; got 5000 characters that are not"),
        (
            '{"a": ["\\ud800"]}',
            r"field a\.0: expected a string that UTF-8 can encode; got the lone surrogate in '\\ud800'",
        ),
        (
            '{"a": {"CAM\\uDFFF": 1}}',
            r"field a: expected a string that UTF-8 can encode; got the lone surrogate in 'CAM\\udfff'",
        ),
        ('["\\ude97\\ud83d"]', r"field 0: expected a string that UTF-8 can encode"),
        ('["a\nb"]', "expected JSON; got 7 characters that are not"),
        ('{"a": 1}\0', "expected JSON; got 9 characters that are not"),
        ('{"a": 1,}', "expected JSON"),
        ("{'a': 1}", "expected JSON"),
        ('{"a": 1} {}', "expected JSON"),
        ('{"a": 01}', "expected JSON"),
        ("", "expected JSON; got 0 characters"),
        (nested(200_000), "expected JSON; got arrays or objects that are nested too deeply"),
        ('{"a":' * 100_000, "expected JSON; got arrays or objects that are nested too deeply"),
    ],
)
def test_other_text_is_refused_with_the_place_and_the_reason(text, message):
    with pytest.raises(JsonError, match=message):
        parse_strict_json(text.encode())


@pytest.mark.parametrize(
    ("content", "got"),
    [
        ("{}".encode("utf-8-sig"), "UTF-8 with a byte order mark"),
        ("{}".encode("utf-16"), "UTF-16"),
        ('{"a": 1}'.encode("utf-16-le"), "UTF-16-LE"),
        ('{"a": 1}'.encode("utf-16-be"), "UTF-16-BE"),
        ("{}".encode("utf-32"), "UTF-32"),
        ('{"a": "é"}'.encode("latin-1"), "bytes that are not"),
        (b'"\xed\xa0\x80"', "bytes that are not"),  # a lone surrogate in the file itself
        (b"\x89PNG\r\n", "bytes that are not"),
    ],
)
def test_another_encoding_is_refused_by_name(content, got):
    with pytest.raises(JsonError, match=rf"expected UTF-8 text; got {got}"):
        parse_strict_json(content)


def test_messages_have_no_control_characters():
    for text in ('{"\\u001b[2J": 1, "\\u001b[2J": 2}', '{"\\u001b[2J\\u202e": NaN}', '["\\u001b\\ud800"]'):
        with pytest.raises(JsonError) as refusal:
            parse_strict_json(text.encode())
        assert str(refusal.value).isprintable()
        assert "\\x1b" in str(refusal.value)
