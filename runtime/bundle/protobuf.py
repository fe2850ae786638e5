"""Strict parsing of protobuf messages by a table of their fields, without a protobuf library.

Protobuf libraries accept many byte sequences for one message, and do not agree on all of them. For example, the C++
parser ignores the bits of a field's key above the 32nd, so that another parser sees another field. Here a message is
accepted only in the form in which libraries write it:

1. Every integer has its shortest encoding and fits its type. So no key and no length can be read in two ways.
2. Every field is in the table, with its own wire type. Nothing is skipped as unknown. There are no groups.
3. A field that is not repeated occurs at most once. Libraries merge two occurrences, or keep the last one.
4. Text is UTF-8.

The order of fields is free. Tensor data and other bytes are not copied.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

VARINT, FIXED64, BYTES, FIXED32 = 0, 1, 2, 5  # the wire types
_FIXED_SIZES = {FIXED64: 8, FIXED32: 4}

Fields = dict[int, list[Any]]  # by field number: each value, in the order of the file


class ProtobufError(Exception):
    """The bytes are not a message of the expected type in strict form. The text says why."""


@dataclass(frozen=True)
class FieldType:
    """A row of a message's table.

    message: the type of a submessage. Otherwise the values are int for VARINT, str for text, and memoryview.
    largest: the largest number, for VARINT.
    """

    name: str
    wire_type: int
    repeated: bool = False
    message: "MessageType | None" = None
    is_text: bool = False
    largest: int = 2**64 - 1


@dataclass(frozen=True)
class MessageType:
    """The name of a message, and its fields by number."""

    name: str
    fields: Mapping[int, FieldType]


def int64(name: str, repeated: bool = False) -> FieldType:
    """An int64 field. Negative numbers are read as numbers of 2**63 and more."""
    return FieldType(name, VARINT, repeated)


def int32(name: str, largest: int = 2**31 - 1) -> FieldType:
    """An int32 or enum field. Negative numbers, which need 64 bits, are not accepted.

    largest: of an enum. Libraries treat the field as unknown if its value is not in the enum.
    """
    return FieldType(name, VARINT, largest=largest)


def float32(name: str) -> FieldType:
    """A float field, as a memoryview of 4 bytes."""
    return FieldType(name, FIXED32)


def text(name: str, repeated: bool = False) -> FieldType:
    """A string field."""
    return FieldType(name, BYTES, repeated, is_text=True)


def data(name: str, repeated: bool = False) -> FieldType:
    """A bytes field, or a submessage that is not parsed."""
    return FieldType(name, BYTES, repeated)


def submessage(name: str, message: MessageType, repeated: bool = False) -> FieldType:
    """A field with a message of its own."""
    return FieldType(name, BYTES, repeated, message)


def parse(content: bytes, message: MessageType, max_fields: int) -> Fields:
    """Parse a message and its submessages, which are `Fields` too. Raises ProtobufError.

    max_fields: largest number of fields in all messages together.
    """
    return _Parser(max_fields).parse(memoryview(content), message)


class _Parser:
    def __init__(self, max_fields: int) -> None:
        self._fields_left = max_fields

    def parse(self, content: memoryview, message: MessageType) -> Fields:
        values: Fields = {}
        for number, wire_type, value in _raw_fields(content):
            self._fields_left -= 1
            if self._fields_left < 0:
                raise ProtobufError("too many fields")
            field = message.fields.get(number)
            if field is None:
                raise ProtobufError(f"field {number} of {message.name}, which no exported graph has")
            if wire_type != field.wire_type:
                raise ProtobufError(f"{message.name}.{field.name} with the wire type {wire_type}")
            if number in values and not field.repeated:
                raise ProtobufError(f"{message.name}.{field.name} twice")
            values.setdefault(number, []).append(self._convert(value, field, message))
        return values

    def _convert(self, value: int | memoryview, field: FieldType, message: MessageType) -> Any:
        if isinstance(value, int):
            if value > field.largest:
                raise ProtobufError(f"{message.name}.{field.name} above {field.largest}")
            return value
        if field.message is not None:
            return self.parse(value, field.message)
        if field.is_text:
            try:
                return str(value, "utf-8")
            except UnicodeDecodeError:
                raise ProtobufError(f"{message.name}.{field.name}, which is not UTF-8") from None
        return value


def _raw_fields(content: memoryview) -> Iterator[tuple[int, int, int | memoryview]]:
    """Yield number, wire type and value of each field of a message, in the order of the file."""
    offset, end = 0, len(content)
    while offset < end:
        key, offset = _varint(content, offset)
        number, wire_type = key >> 3, key & 7
        if number == 0 or key >= 2**32:
            raise ProtobufError(f"the field number {number}")
        if wire_type == VARINT:
            number_value, offset = _varint(content, offset)
            yield number, wire_type, number_value
            continue
        if wire_type == BYTES:
            size, offset = _varint(content, offset)
        elif wire_type in _FIXED_SIZES:
            size = _FIXED_SIZES[wire_type]
        else:
            raise ProtobufError(f"the wire type {wire_type}")
        if size > end - offset:
            raise ProtobufError("a field that is longer than its message")
        yield number, wire_type, content[offset : offset + size]
        offset += size


def _varint(content: memoryview, offset: int) -> tuple[int, int]:
    """Decode the variable-length integer at `offset`. Returns it and the offset after it.

    It has seven bits per byte, lowest first. All bytes but the last have the top bit set.
    """
    if offset < len(content) and content[offset] < 0x80:  # nearly always
        return content[offset], offset + 1
    value = shift = 0
    for byte in content[offset : offset + 10]:  # 64 bits take at most 10 bytes
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            if byte == 0:
                raise ProtobufError("an integer that is not in its shortest encoding")
            if value >= 2**64:
                raise ProtobufError("an integer above 64 bits")
            return value, offset + shift // 7 + 1
        shift += 7
    raise ProtobufError("an integer without an end")
