"""Protobuf's wire format: fields in the usual encoding, and in those that only an attacker writes."""

VARINT, FIXED64, BYTES, START_GROUP, END_GROUP, FIXED32 = 0, 1, 2, 3, 4, 5


def varint(value: int, padding: int = 0) -> bytes:
    """Encode an integer, with `padding` bytes more than necessary."""
    encoded = bytearray()
    while value > 0x7F:
        encoded.append(value & 0x7F | 0x80)
        value >>= 7
    encoded.append(value)
    for _ in range(padding):
        encoded[-1] |= 0x80
        encoded.append(0)
    return bytes(encoded)


def key(number: int, wire_type: int, padding: int = 0) -> bytes:
    """Encode the key of a field."""
    return varint(number << 3 | wire_type, padding)


def field(number: int, value: bytes | int) -> bytes:
    """Encode a field: a submessage, text or bytes, or a number."""
    if isinstance(value, int):
        return key(number, VARINT) + varint(value)
    return key(number, BYTES) + varint(len(value)) + value
