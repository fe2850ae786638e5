import pytest

from duospacenet.runtime.bundle.protobuf import (
    MessageType,
    ProtobufError,
    data,
    float32,
    int32,
    int64,
    parse,
    submessage,
    text,
)
from tests.helpers.wire_format import BYTES, END_GROUP, FIXED32, FIXED64, START_GROUP, VARINT, field, key, varint

INNER = MessageType("Inner", {1: int64("number", repeated=True)})
MESSAGE = MessageType(
    "Outer",
    {
        1: int64("number"),
        2: int32("small", largest=14),
        3: float32("decimal"),
        4: text("name"),
        5: data("bytes", repeated=True),
        16: submessage("inner", INNER, repeated=True),
        2**29 - 1: int64("last"),
    },
)


def read(content: bytes, max_fields: int = 100):
    return parse(content, MESSAGE, max_fields)


def test_a_message_is_read_in_any_order_of_its_fields():
    content = (
        field(16, field(1, 7) + field(1, 2**64 - 1))
        + field(4, "ä".encode())
        + key(3, FIXED32)
        + b"\0\0\x80\x3f"
        + field(5, b"\xff")
        + field(1, 300)
        + field(5, b"")
        + field(2**29 - 1, 1)
        + field(2, 14)
        + field(16, b"")
    )
    assert read(content) == {
        16: [{1: [7, 2**64 - 1]}, {}],
        4: ["ä"],
        3: [b"\0\0\x80\x3f"],
        5: [b"\xff", b""],
        1: [300],
        2**29 - 1: [1],
        2: [14],
    }


def test_bytes_are_not_copied():
    content = field(5, b"x" * 100)
    assert read(content)[5][0].obj is content


REFUSED = {
    "the field number 0": (key(0, VARINT) + b"\0", "the field number 0"),
    "a key above 32 bits, which other parsers read as field 1": (varint(1 << 3 | 1 << 32) + b"\0", "the field number"),
    "a key above 64 bits": (b"\x88" + b"\x80" * 8 + b"\x02" + b"\0", "an integer above 64 bits"),
    "a padded key": (key(1, VARINT, padding=2) + b"\0", "not in its shortest encoding"),
    "a padded number": (key(1, VARINT) + varint(5, padding=1), "not in its shortest encoding"),
    "a padded zero": (key(1, VARINT) + b"\x80\0", "not in its shortest encoding"),
    "a padded length": (key(4, BYTES) + varint(1, padding=1) + b"a", "not in its shortest encoding"),
    "a number of eleven bytes": (key(1, VARINT) + b"\x80" * 10 + b"\1", "an integer without an end"),
    "a number of ten bytes above 64 bits": (key(1, VARINT) + b"\xff" * 9 + b"\x02", "an integer above 64 bits"),
    "a number without an end": (key(1, VARINT) + b"\x80", "an integer without an end"),
    "a key alone": (key(1, VARINT), "an integer without an end"),
    "a length behind the end": (key(4, BYTES) + varint(2) + b"a", "longer than its message"),
    "a length of 2**31": (key(4, BYTES) + varint(2**31) + b"a", "longer than its message"),
    "a length of 2**64 - 1": (key(4, BYTES) + varint(2**64 - 1) + b"a", "longer than its message"),
    "half a float": (key(3, FIXED32) + b"\0\0", "longer than its message"),
    "a submessage with half a number": (field(16, key(1, VARINT)) + b"\1", "an integer without an end"),
    "a group": (key(6, START_GROUP) + key(6, END_GROUP), "the wire type 3"),
    "the end of a group": (key(1, END_GROUP), "the wire type 4"),
    "the wire type 6": (key(1, 6), "the wire type 6"),
    "the wire type 7": (key(1, 7), "the wire type 7"),
    "a number with the type of text": (field(1, b"a"), "Outer.number with the wire type 2"),
    "text with the type of a number": (field(4, 1), "Outer.name with the wire type 0"),
    "a float with the type of a double": (key(3, FIXED64) + b"\0" * 8, "Outer.decimal with the wire type 1"),
    "packed numbers": (field(16, field(1, b"\1\2")), "Inner.number with the wire type 2"),
    "an unknown field": (field(6, 1), "field 6 of Outer"),
    "an unknown field of a submessage": (field(16, field(2, 1)), "field 2 of Inner"),
    "a field twice": (field(1, 1) + field(4, b"") + field(1, 1), "Outer.number twice"),
    "a value outside of its enum": (field(2, 15), "Outer.small above 14"),
    "a value that has other low bits": (field(2, 2**32 + 1), "Outer.small above 14"),
    "text that is not UTF-8": (field(4, b"\xff"), "Outer.name, which is not UTF-8"),
    "a lone surrogate": (field(4, b"\xed\xa0\x80"), "Outer.name, which is not UTF-8"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_parsers_may_read_in_different_ways_is_refused(case):
    content, message = REFUSED[case]
    with pytest.raises(ProtobufError, match=message):
        read(content)


def test_the_number_of_fields_is_limited_over_all_messages():
    content = field(16, field(1, 1) * 3) * 2
    assert len(read(content, max_fields=8)[16]) == 2
    with pytest.raises(ProtobufError, match="too many fields"):
        read(content, max_fields=7)
