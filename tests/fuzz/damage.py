"""Strategies of damage: to JSON values, by path, and to bytes."""

import copy
import json
from typing import Any

from hypothesis import strategies as st

# What stands in files of other programs, of other versions, and in those of people with bad intentions.
ODD_VALUES = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(-3, 3),
    st.sampled_from([2**31, -(2**63), 10**400, 1e308, -1e-320, 5e6, 0.0, -0.0, float("nan"), float("inf")]),
    st.floats(),
    st.text(max_size=8),
    st.sampled_from(["", "..", "/", "../../etc/passwd", "\x00", "\ud800", "1e5", "NaN", "true", "a" * 300]),
    st.sampled_from([[], {}, [[]], [None], {"": None}, [0] * 16, [[1, 0, 0], [0, 1, 0], [0, 0, 1]]]),
)


@st.composite
def damaged_json(draw: st.DrawFn, value: Any) -> Any:
    """`value` with one to three of its parts replaced, removed, doubled or moved."""
    root = {"root": copy.deepcopy(value)}
    for _ in range(draw(st.integers(1, 3))):
        *way, last = draw(st.sampled_from(_paths(root["root"]) or [("root",)]))
        part = root if last == "root" and not way else _walk(root["root"], way)
        _damage(draw, part, last, root["root"])
    return root["root"]


@st.composite
def damaged_bytes(draw: st.DrawFn, whole: bytes) -> bytes:
    """`whole` with some bytes changed, a piece removed or doubled, or its end cut off."""
    data = bytearray(whole)
    for _ in range(draw(st.integers(1, 4))):
        # Most formats keep what matters at their ends.
        at = draw(st.one_of(st.integers(0, len(data)), st.integers(0, min(len(data), 600))))
        size = draw(st.integers(0, 64))
        kind = draw(st.sampled_from(["change", "remove", "double", "cut", "insert"]))
        if kind == "change":
            data[at : at + size] = draw(st.binary(min_size=size, max_size=size))
        elif kind == "remove":
            del data[at : at + size]
        elif kind == "double":
            data[at:at] = data[at : at + size]
        elif kind == "insert":
            data[at:at] = draw(st.binary(max_size=16))
        else:
            del data[at:]
    return bytes(data)


def to_text(value: Any) -> bytes:
    """A JSON value as a careless program writes it: NaN, Infinity and lone surrogates pass."""
    return json.dumps(value).encode()


def _paths(value: Any, way: tuple = ()) -> list[tuple]:
    """The ways to all parts of a JSON value; long lists by their first and last."""
    if isinstance(value, dict):
        parts = list(value.items())
    elif isinstance(value, list):
        parts = [(index, value[index]) for index in sorted({0, len(value) - 1})] if value else []
    else:
        parts = []
    return [path for key, part in parts for path in ((*way, key), *_paths(part, (*way, key)))]


def _walk(value: Any, way: list) -> Any:
    for step in way:
        value = value[step]
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
        part[key] = copy.deepcopy(_walk(root, list(draw(st.sampled_from(_paths(root))))))
    else:
        part[key] = draw(ODD_VALUES)


def _is_scalable(value: Any) -> bool:
    """A number that Python can multiply with a float: an integer that was put there before may be beyond all floats."""
    return isinstance(value, (int, float)) and not isinstance(value, bool) and abs(value) < 10**300
