"""Damage to protobuf files that knows their structure: fields in unusual encodings, places, types and numbers."""

import struct
from dataclasses import dataclass, replace
from random import Random
from typing import Any

from google.protobuf.descriptor import Descriptor, FieldDescriptor
from google.protobuf.message import Message

from tests.helpers.wire_format import BYTES, END_GROUP, FIXED32, FIXED64, START_GROUP, VARINT, varint

ODD_NUMBERS = [
    0,
    1,
    2,
    7,
    14,
    15,
    127,
    128,
    300,
    2**31 - 1,
    2**31,
    2**32,
    2**32 + 1,
    2**63,
    2**64 - 1,
    2**64 + 1,
    2**70 - 1,
]
ODD_FIELD_NUMBERS = [0, 12, 17, 21, 99, 1000, 2**29 - 1, 2**29, 2**29 + 7, 2**32 + 5]
ODD_TEXTS = [b"", b"Loop", b"If", b"Relu", b"com.example", b"ai.onnx", b"\xff", b"w", b"location", b"../secret"]

# Fields that no graph file may have, with a value: the first thing that an attacker hides.
FORBIDDEN: dict[str, list[tuple[int, int | bytes]]] = {
    "ModelProto": [(20, b""), (25, b"")],  # training_info, functions
    "GraphProto": [(15, b"")],  # sparse_initializer
    "NodeProto": [(4, b"Loop"), (7, b"com.example")],  # op_type, domain
    "AttributeProto": [(number, b"") for number in (5, 6, 10, 11, 14, 21, 22, 23)],  # tensors, graphs and others
    "TensorProto": [(13, b""), (14, 1), (14, 2**32 + 1)],  # external_data, data_location
    "OperatorSetIdProto": [(1, b"com.example"), (2, 7)],
}


@dataclass
class Part:
    """One field of a message, with its encoding.

    value: a number for VARINT, bytes, or the parts of a submessage.
    message: the type of a submessage, also if it is empty.
    *_padding: bytes more than necessary. extra_length: is added to the length.
    """

    number: int
    wire_type: int
    value: Any
    message: Descriptor | None = None
    key_padding: int = 0
    length_padding: int = 0
    value_padding: int = 0
    extra_length: int = 0
    key_high_bits: int = 0

    def encode(self) -> bytes:
        """Return the bytes of the field."""
        key = varint(self.number << 3 | self.wire_type | self.key_high_bits << 32, self.key_padding)
        if self.wire_type in (START_GROUP, END_GROUP):
            return key
        if isinstance(self.value, int):
            if self.wire_type == VARINT:
                return key + varint(self.value, self.value_padding)
            return key + self.value.to_bytes(16, "little")[: {FIXED32: 4, FIXED64: 8}.get(self.wire_type, 16)]
        content = self.value if isinstance(self.value, bytes) else encode(self.value)
        if self.wire_type == BYTES:
            return key + varint(max(0, len(content) + self.extra_length), self.length_padding) + content
        return key + content


def encode(parts: list[Part]) -> bytes:
    """Return the bytes of a message."""
    return b"".join(part.encode() for part in parts)


def to_parts(message: Message) -> list[Part]:
    """Return the fields of a message as the library would write them."""
    parts = []
    for descriptor, value in message.ListFields():
        is_single = isinstance(value, (int, float, str, bytes, Message))
        parts.extend(_to_part(descriptor, item) for item in ([value] if is_single else value))
    return sorted(parts, key=lambda part: part.number)


def _to_part(descriptor: FieldDescriptor, item: Any) -> Part:
    number = descriptor.number
    if descriptor.message_type is not None:
        return Part(number, BYTES, to_parts(item), descriptor.message_type)
    if isinstance(item, (str, bytes)):
        return Part(number, BYTES, item.encode() if isinstance(item, str) else item)
    if descriptor.type == FieldDescriptor.TYPE_FLOAT:
        return Part(number, FIXED32, struct.pack("<f", item))
    return Part(number, VARINT, item % 2**64)


def damage(root: list[Part], message: Descriptor, random: Random) -> bytes:
    """Return the bytes of a copy of `root`, a message of the type `message`, with one to three damages."""
    tree = Part(0, BYTES, copy(root), message)
    for _ in range(random.choice([1, 1, 2, 3])):
        owners = _messages(tree)
        # First the type, because there are many more dimensions than tensors.
        name = random.choice(sorted({_name(part) for part in owners}))
        random.choice(DAMAGES)(random.choice([part for part in owners if _name(part) == name]), random)
    data = bytearray(encode(tree.value))
    if random.random() < 0.1 and data:
        for _ in range(random.randint(1, 3)):
            data[random.randrange(len(data))] = random.choice([random.randrange(256), 0, 0x80, 0xFF])
    return bytes(data)


def copy(parts: list[Part]) -> list[Part]:
    """Return a deep copy."""
    return [replace(part, value=copy(part.value) if isinstance(part.value, list) else part.value) for part in parts]


def _messages(part: Part) -> list[Part]:
    """Return the message and all messages in it."""
    if not isinstance(part.value, list):
        return []
    return [part, *(inner for child in part.value for inner in _messages(child))]


# --- Damages of one message ---------------------------------------------------------------------------------------


def duplicate(owner: Part, random: Random) -> None:
    if owner.value:
        part = copy([random.choice(owner.value)])[0]
        owner.value.insert(random.randint(0, len(owner.value)), part)


def remove(owner: Part, random: Random) -> None:
    if owner.value:
        owner.value.pop(random.randrange(len(owner.value)))


def shuffle(owner: Part, random: Random) -> None:
    random.shuffle(owner.value)


def pad_an_integer(owner: Part, random: Random) -> None:
    if owner.value:
        part = random.choice(owner.value)
        name = random.choice(["key_padding", "length_padding", "value_padding"])
        setattr(part, name, random.randint(1, 6))


def set_high_bits_of_a_key(owner: Part, random: Random) -> None:
    if owner.value:
        random.choice(owner.value).key_high_bits = random.choice([1, 2, 7, 8, 2**20, 2**32 - 1])


def change_a_length(owner: Part, random: Random) -> None:
    if owner.value:
        random.choice(owner.value).extra_length = random.choice([-2, -1, 1, 2, 2**31, 2**32, 2**64 - 1])


def change_a_wire_type(owner: Part, random: Random) -> None:
    if owner.value:
        random.choice(owner.value).wire_type = random.randrange(8)


def change_a_field_number(owner: Part, random: Random) -> None:
    if owner.value:
        random.choice(owner.value).number = random.choice([*_numbers(owner), *ODD_FIELD_NUMBERS])


def change_a_value(owner: Part, random: Random) -> None:
    if owner.value:
        part = random.choice(owner.value)
        if isinstance(part.value, int):
            part.value = random.choice(ODD_NUMBERS)
        elif isinstance(part.value, bytes):
            part.value = random.choice([*ODD_TEXTS, part.value[:-1], part.value + b"\0"])


def insert_a_field(owner: Part, random: Random) -> None:
    """Insert any field of the message's type, or one that it does not have."""
    number = random.choice([*_numbers(owner), *ODD_FIELD_NUMBERS])
    descriptor = owner.message.fields_by_number.get(number) if owner.message else None
    inner = descriptor.message_type if descriptor else None
    if inner is not None:
        part = Part(number, BYTES, [], inner)
        while random.random() < 0.4:
            insert_a_field(part, random)
    elif random.random() < 0.5:
        part = Part(number, VARINT, random.choice(ODD_NUMBERS))
    else:
        part = Part(number, BYTES, random.choice(ODD_TEXTS))
    owner.value.insert(random.randint(0, len(owner.value)), part)


def insert_a_forbidden_field(owner: Part, random: Random) -> None:
    """Insert a forbidden field, in a plain or an unusual encoding. An intact field of the same number is replaced."""
    number, value = random.choice(FORBIDDEN.get(_name(owner), [(12, b"")]))
    part = Part(number, VARINT if isinstance(value, int) else BYTES, value)
    if random.random() < 0.5:
        part.key_high_bits = random.choice([0, 1, 7])
        part.key_padding = random.choice([0, 0, 1, 4, 9])
        part.length_padding = random.choice([0, 0, 1, 5])
        part.value_padding = random.choice([0, 0, 1, 5])
    if random.random() < 0.7:
        owner.value[:] = [other for other in owner.value if other.number != number]
    owner.value.insert(random.randint(0, len(owner.value)), part)


def wrap_in_a_group(owner: Part, random: Random) -> None:
    """Put a field between the start and the end of a group, or write only one of the two."""
    at = random.randint(0, len(owner.value))
    number = random.choice([*_numbers(owner), *ODD_FIELD_NUMBERS])
    end = min(len(owner.value), at + random.randint(0, 2))
    if random.random() < 0.8:
        owner.value.insert(end, Part(number, END_GROUP, b""))
    owner.value.insert(at, Part(number, START_GROUP, b""))


def split_a_message(owner: Part, random: Random) -> None:
    """Write the fields of a submessage in two submessages, which libraries merge if the field is not repeated."""
    places = [index for index, part in enumerate(owner.value) if isinstance(part.value, list)]
    if places:
        at = random.choice(places)
        whole = owner.value[at]
        middle = random.randint(0, len(whole.value))
        second = replace(whole, value=whole.value[middle:])
        whole.value = whole.value[:middle]
        owner.value.insert(random.randint(at + 1, len(owner.value)), second)


def pack(owner: Part, random: Random) -> None:
    """Write all numbers of one field as one packed field."""
    numbers = [part.number for part in owner.value if part.wire_type == VARINT and isinstance(part.value, int)]
    if numbers:
        number = random.choice(numbers)
        packed = b"".join(varint(p.value) for p in owner.value if p.number == number and isinstance(p.value, int))
        owner.value[:] = [part for part in owner.value if part.number != number]
        owner.value.append(Part(number, BYTES, packed))


def empty_a_message(owner: Part, random: Random) -> None:
    owner.value.clear()


DAMAGES = [
    duplicate,
    remove,
    shuffle,
    pad_an_integer,
    set_high_bits_of_a_key,
    change_a_length,
    change_a_wire_type,
    change_a_field_number,
    change_a_value,
    insert_a_field,
    insert_a_field,
    insert_a_forbidden_field,
    insert_a_forbidden_field,
    insert_a_forbidden_field,
    wrap_in_a_group,
    split_a_message,
    pack,
    empty_a_message,
]


def _name(part: Part) -> str:
    return str(part.message.name) if part.message else ""


def _numbers(owner: Part) -> list[int]:
    return list(owner.message.fields_by_number) if owner.message else [1]
