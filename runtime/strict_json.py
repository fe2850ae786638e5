"""Strict JSON: files that other readers would understand differently, or that cannot be stored or printed, are refused.

Python's parser accepts more than the standard: of two equal keys it uses the last, it accepts NaN and Infinity, reads
1e400 as infinity, and returns a lone surrogate as a string that cannot be encoded.
"""

import json
import math
import re
from collections import Counter
from collections.abc import Iterable, Iterator
from typing import Any, Final

from .printable import printable, shortened

LARGEST_INTEGER: Final = 2**64 - 1

# Only values with one of these can be wrong: a constant, an escaped surrogate, a large exponent, or many digits.
_SUSPICIOUS = re.compile(r"NaN|Infinity|\\u[dD][89a-fA-F]|[eE]\+?\d{3}|\d{19}")

_Place = tuple[str | int, ...]


class JsonError(ValueError):
    """A text is not strict JSON. The message says what was expected and found, and what to do."""


def parse_strict_json(content: bytes) -> Any:
    """Parse UTF-8 text as JSON.

    Raises JsonError for another encoding, a syntax error, a key that occurs twice in an object, a number that is not
    finite or too large, and a string that cannot be encoded as UTF-8.
    """
    text = _decode(content)
    try:
        value = json.loads(text, object_pairs_hook=_to_object)
    except JsonError:
        raise
    except RecursionError:
        raise JsonError("expected JSON; got arrays or objects that are nested too deeply.") from None
    except ValueError as error:  # a syntax error, or an integer of thousands of digits
        raise JsonError(f"expected JSON; got {len(text)} characters that are not ({error}).") from None
    if _SUSPICIOUS.search(text):
        for place, part in _parts(value):
            _check_value(place, part)
    return value


def dotted(place: Iterable[str | int]) -> str:
    """Return the place of a value as one printable text: its keys and indices, separated by dots."""
    return printable(".".join(map(str, place)))


def _decode(content: bytes) -> str:
    encoding = json.detect_encoding(content)
    if encoding != "utf-8":
        got = "UTF-8 with a byte order mark" if encoding == "utf-8-sig" else encoding.upper()
        raise JsonError(f"expected UTF-8 text; got {got}. Save the file as UTF-8 without a byte order mark.")
    try:
        return content.decode("utf-8")
    except UnicodeDecodeError as error:
        raise JsonError(f"expected UTF-8 text; got bytes that are not ({error}). Save the file as UTF-8.") from None


def _to_object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    value = dict(pairs)
    if len(value) < len(pairs):
        counts = Counter(key for key, _ in pairs)
        key, count = counts.most_common(1)[0]
        raise JsonError(
            f"expected each key once in an object; got {shortened(key)} {count} times. Remove or rename the others."
        )
    return value


def _parts(value: Any) -> Iterator[tuple[_Place, Any]]:
    """Yield the place and value of every string, number and key. Iterative, because values can be nested deeply."""
    stack: list[tuple[_Place, Any]] = [((), value)]
    while stack:
        place, part = stack.pop()
        if isinstance(part, dict):
            stack.extend(((*place, key), value) for key, value in reversed(part.items()))
            stack.extend((place, key) for key in part)
        elif isinstance(part, list):
            stack.extend(((*place, index), value) for index, value in reversed(list(enumerate(part))))
        else:
            yield place, part


def _check_value(place: _Place, value: Any) -> None:
    field = f"field {dotted(place)}: " if place else ""
    if isinstance(value, float) and not math.isfinite(value):
        raise JsonError(f"{field}expected a finite number in the range of float64; got {value}.")
    if isinstance(value, int) and abs(value) > LARGEST_INTEGER:
        raise JsonError(f"{field}expected an integer of at most 64 bits; got {len(str(abs(value)))} digits.")
    if isinstance(value, str) and not _is_encodable(value):
        raise JsonError(
            f"{field}expected a string that UTF-8 can encode; got the lone surrogate in {shortened(value)}."
        )


def _is_encodable(text: str) -> bool:
    try:
        text.encode()
    except UnicodeEncodeError:
        return False
    return True
