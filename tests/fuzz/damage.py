"""Hypothesis strategies that damage JSON values and bytes."""

import copy
import json
from typing import Any

from hypothesis import strategies as st

# Values as other programs, other versions and attackers write them.
ODD_VALUES = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(-3, 3),
    st.sampled_from([2**31, -(2**63), 10**400, 1e308, -1e-320, 5e6, 0.0, -0.0, float("nan"), float("inf")]),
    st.floats(),
    st.text(max_size=8),
    st.sampled_from(["", "..", "/", "../../etc/passwd", "\x00", "\ud800", "1e5", "NaN", "true", "a" * 300]),
    st.sampled_from([[], {}, [[]], [None], {"": None}, [0] * 16, [[1, 0, 0], [0, 1, 0], [0, 0, 1]]]),
).map(copy.deepcopy)  # a later damage may change the value, but not the one in this list


@st.composite
def damaged_json(draw: st.DrawFn, value: Any) -> Any:
    """`value` with one to three parts replaced, removed, scaled, duplicated or moved."""
    root = {"root": copy.deepcopy(value)}
    for _ in range(draw(st.integers(1, 3))):
        *parents, last = draw(st.sampled_from(_paths(root["root"]) or [("root",)]))
        part = root if last == "root" and not parents else _walk(root["root"], parents)
        _damage(draw, part, last, root["root"])
        root.setdefault("root", None)  # it may have been removed as a whole
    return root["root"]


@st.composite
def damaged_bytes(draw: st.DrawFn, intact: bytes) -> bytes:
    """`intact` with bytes changed, inserted, removed or duplicated, or with its end cut off."""
    data = bytearray(intact)
    for _ in range(draw(st.integers(1, 4))):
        # Half of the positions are in the first 600 bytes, where most formats have their header.
        at = draw(st.one_of(st.integers(0, len(data)), st.integers(0, min(len(data), 600))))
        size = draw(st.integers(0, 64))
        kind = draw(st.sampled_from(["change", "remove", "duplicate", "cut", "insert"]))
        if kind == "change":
            data[at : at + size] = draw(st.binary(min_size=size, max_size=size))
        elif kind == "remove":
            del data[at : at + size]
        elif kind == "duplicate":
            data[at:at] = data[at : at + size]
        elif kind == "insert":
            data[at:at] = draw(st.binary(max_size=16))
        else:
            del data[at:]
    return bytes(data)


def to_text(value: Any) -> bytes:
    """A JSON value as a careless program writes it: with NaN, Infinity and lone surrogates."""
    return json.dumps(value).encode()


def _paths(value: Any, prefix: tuple = ()) -> list[tuple]:
    """The paths to all parts of a JSON value. Of a list, only the first and the last element are visited."""
    if isinstance(value, dict):
        parts = list(value.items())
    elif isinstance(value, list):
        parts = [(index, value[index]) for index in sorted({0, len(value) - 1})] if value else []
    else:
        parts = []
    return [path for key, part in parts for path in ((*prefix, key), *_paths(part, (*prefix, key)))]


def _walk(value: Any, path: list) -> Any:
    for key in path:
        value = value[key]
    return value


def _damage(draw: st.DrawFn, part: Any, key: Any, root: Any) -> None:
    kind = draw(st.sampled_from(["replace", "remove", "scale", "add", "move"]))
    if kind == "remove":
        del part[key]
    elif kind == "scale" and _is_scalable(part[key]):
        part[key] = part[key] * draw(st.sampled_from([-1, 1e-3, 1e3, 1e9, 2]))
    elif kind == "add" and isinstance(part, dict):
        part[draw(st.text(max_size=6))] = draw(ODD_VALUES)
    elif kind == "add" and isinstance(part, list):
        part.append(copy.deepcopy(part[key]))
    elif kind == "move":
        part[key] = copy.deepcopy(_walk(root, list(draw(st.sampled_from(_paths(root) or [()])))))
    else:
        part[key] = draw(ODD_VALUES)


def _is_scalable(value: Any) -> bool:
    """Whether Python can multiply the value with a float. An integer from an earlier damage may exceed every float."""
    return isinstance(value, (int, float)) and not isinstance(value, bool) and abs(value) < 10**300
