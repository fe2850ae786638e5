"""A JSON file that is read value by value, so that a file of any size needs little memory."""

import json
import re
from collections.abc import Iterator
from pathlib import Path
from types import TracebackType
from typing import Any, Self, TextIO

from ..runtime.errors import InputError
from ..runtime.files import check_regular_file
from ..runtime.printable import printable, shortened

MAX_FILE_BYTES = 2**36
CHUNK_CHARACTERS = 2**22
MAX_VALUE_CHARACTERS = 2**26  # a sample of 500 boxes has about 200,000
LONGEST_WORD = 16  # longer than -Infinity, and than an escape in a string

_SPACE = re.compile(r"[ \t\n\r]*")


class JsonStream:
    """Reads the objects of a JSON file from start to end.

    `for key in stream.members()` enters the object that comes next. For each key, the loop reads the value: with
    `value`, or with `members` again if it is a large object. As in Python's `json`, NaN and Infinity are numbers.
    """

    def __init__(self, path: Path) -> None:
        """Raises InputError if there is no such regular file."""
        check_regular_file(path, MAX_FILE_BYTES, InputError)
        self._path = path
        self._text, self._position, self._is_complete = "", 0, False
        self._key: str | None = None  # the last one, for messages
        self._decode = json.JSONDecoder(object_pairs_hook=_to_object).raw_decode

    def __enter__(self) -> Self:
        try:
            self._file: TextIO = self._path.open(encoding="utf-8")
        except OSError as cause:
            raise self._error(f"cannot be read ({cause.strerror})") from None
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self._file.close()

    def members(self) -> Iterator[str]:
        """Yield the keys of the object that comes next. Keys that occur twice are yielded twice.

        Raises InputError, naming the place in the file, for anything else than an object.
        """
        self._expect("{", "a JSON object")
        if self._next() == "}":
            self._position += 1
            return
        while True:
            if self._next() != '"':
                raise self._syntax_error("a key in double quotes")
            self._key = key = self.value()
            self._expect(":", "a colon after the key")
            yield key
            if self._next() == "}":
                self._position += 1
                return
            self._expect(",", "a comma or a closing brace")

    def value(self) -> Any:
        """Return the value that comes next.

        Raises InputError for invalid JSON, for a key that occurs twice in an object, and for a value that has more than
        64 million characters.
        """
        self._next()
        while True:
            try:
                value, end = self._decode(self._text, self._position)
            except json.JSONDecodeError as error:
                if self._is_invalid(error):
                    self._position = error.pos
                    raise self._syntax_error(f"valid JSON ({error.msg})") from None
                self._read_more()
            except RecursionError:
                raise self._syntax_error("arrays and objects that are not nested so deeply") from None
            except _RepeatedKeyError as error:
                raise self._error(f"expected each key once in an object; got {error} twice. Remove one") from None
            except ValueError as error:  # an integer of thousands of digits
                raise self._syntax_error(f"numbers that can be read ({error})") from None
            else:
                # A number may go on after the end of the text.
                if end < len(self._text) or self._is_complete:
                    self._position = end
                    return value
                self._read_more()

    def check_end(self) -> None:
        """Raise InputError if anything follows the values that were read."""
        if self._next():
            raise self._syntax_error("the end of the file")

    def _is_invalid(self, error: json.JSONDecodeError) -> bool:
        """Whether reading more of the file cannot complete the value that could not be decoded."""
        if self._is_complete or len(self._text) - self._position > MAX_VALUE_CHARACTERS:
            return True
        # A value that ends too early is reported at the end of the text, or at the start of a string or a word.
        is_string = error.msg.startswith("Unterminated string")
        return not is_string and error.pos < len(self._text) - LONGEST_WORD

    def _expect(self, character: str, what: str) -> None:
        if self._next() != character:
            raise self._syntax_error(what)
        self._position += 1

    def _next(self) -> str:
        """Skip white space, and return the next character without reading it; "" at the end of the file."""
        while True:
            space = _SPACE.match(self._text, self._position)
            self._position = space.end() if space else self._position
            if self._position < len(self._text) or self._is_complete:
                return self._text[self._position : self._position + 1]
            self._read_more()

    def _read_more(self) -> None:
        """Append a chunk of the file to the text that is not read yet. The chunk doubles with the length of a value."""
        rest = self._text[self._position :]
        try:
            chunk = self._file.read(max(CHUNK_CHARACTERS, len(rest)))
        except UnicodeDecodeError as error:
            raise self._error(f"expected UTF-8 text; got bytes that are not ({error.reason})") from None
        except OSError as cause:
            raise self._error(f"cannot be read ({cause.strerror})") from None
        self._text, self._position, self._is_complete = rest + chunk, 0, not chunk

    def _syntax_error(self, expected: str) -> InputError:
        rest = self._text[self._position : self._position + 40]
        got = shortened(rest) if rest else "the end of the file"
        return self._error(f"expected {expected}; got {got}")

    def _error(self, text: str) -> InputError:
        place = "" if self._key is None else f"after the key {shortened(self._key)}: "
        return InputError(f"{printable(str(self._path))}: {place}{text}.")


class _RepeatedKeyError(ValueError):
    """A key that occurs twice in an object."""


def _to_object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    value = dict(pairs)
    if len(value) < len(pairs):
        keys = [key for key, _ in pairs]
        repeated = next(key for key in keys if keys.count(key) > 1)
        raise _RepeatedKeyError(shortened(repeated))
    return value
