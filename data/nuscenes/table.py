"""A nuScenes table: a JSON file that holds an array of rows. Tables of several gigabytes are read row by row."""

import hashlib
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Generic, NamedTuple, TypeVar

import msgspec
from msgspec import Raw

from ...runtime.errors import InputError
from ...runtime.files import read_regular_file
from ...runtime.printable import has_control_character, printable, shortened
from .table_records import Row

MAX_TABLE_BYTES = 16 * 10**9
MAX_NAME_LENGTH = 1000
MAX_ATTEMPTS = 5  # ends of rows that are tried, to find the last complete row of a damaged table

# RecursionError: JSON of many levels.
PARSER_ERRORS = (msgspec.MsgspecError, UnicodeDecodeError, RecursionError)

RowType = TypeVar("RowType", bound=Row)
Found = TypeVar("Found")


Place = tuple[int, str]  # the number of a row in its table, counted from 0, and its token


class NumberedRow(NamedTuple, Generic[RowType]):
    """A row and its number in the table, counted from 0."""

    number: int
    row: RowType

    @property
    def place(self) -> Place:
        return self.number, self.row.token


class Table(Generic[RowType]):
    """The rows of one table, in file order. Iterating decodes them one by one.

    path: of the file.
    sha256: of its content.
    """

    def __init__(self, path: Path, row_type: type[RowType]) -> None:
        """Raises InputError, naming the file, if it is missing, or is not a JSON array."""
        check_exists(path)
        self.path = path
        content = read_regular_file(path, MAX_TABLE_BYTES, InputError)
        self.sha256 = hashlib.sha256(content).hexdigest()
        self._rows = _split_rows(self.path, content)
        self._decoder = msgspec.json.Decoder(row_type)

    def __len__(self) -> int:
        return len(self._rows)

    def __iter__(self) -> Iterator[NumberedRow[RowType]]:
        """Yield the rows. Raises InputError, naming the table, the row and the field, for a row that is not valid."""
        return self.rows(0, len(self))

    def rows(self, start: int, stop: int) -> Iterator[NumberedRow[RowType]]:
        """Yield the rows from number `start` to before `stop`, as iterating does."""
        decode = self._decoder.decode
        for number, raw in enumerate(self._rows[start:stop], start):
            try:
                row = decode(raw)
            except PARSER_ERRORS as error:
                raise row_error(self.path, (number, _token_of(raw)), _describe(error)) from None
            if not row.token.isascii() or not row.token.isprintable() or not row.token:
                raise row_error(self.path, (number, row.token), "expected a token of printable ASCII characters")
            yield NumberedRow(number, row)

    def by_token(self) -> dict[str, NumberedRow[RowType]]:
        """Return all rows by token. Raises InputError for a row that is not valid, or a token that occurs twice."""
        rows: dict[str, NumberedRow[RowType]] = {}
        for numbered in self:
            if (first := rows.setdefault(numbered.row.token, numbered)) is not numbered:
                raise repeated_error(self.path, numbered.place, first.number)
        return rows

    def find(self, numbered: NumberedRow[RowType], field: str, rows: Mapping[str, Found], table: str) -> Found:
        """Return the row of another table that `field` names. Raises InputError if that table does not have it.

        rows: of the other table, by token. table: its name.
        """
        token: str = getattr(numbered.row, field)
        found = rows.get(token)
        if found is None:
            raise dangling_error(self.path, numbered.place, field, token, table)
        return found

    def check_name(self, numbered: NumberedRow[RowType], field: str) -> str:
        """Return the text in `field`, after a check that it is short and can be printed. Raises InputError."""
        name: str = getattr(numbered.row, field)
        if not name or (not name.isprintable() and has_control_character(name)):
            message = f"expected {field} without control characters, and not empty; got {shortened(name)}"
            raise row_error(self.path, numbered.place, message)
        if len(name) > MAX_NAME_LENGTH:
            message = f"expected {field} of at most {MAX_NAME_LENGTH} characters; got {len(name)}: {shortened(name)}"
            raise row_error(self.path, numbered.place, message)
        return name


def check_exists(path: Path) -> None:
    """Raises InputError if there is no such table."""
    if not path.exists():
        raise InputError(
            f"{path}: expected the nuScenes table {path.stem}; got no such file. "
            "Unpack the metadata archive of this version into the root again."
        )


def row_error(path: Path, place: Place, message: str) -> InputError:
    """Return the error for one row of the table `path`. message: expected and found, without a full stop."""
    number, token = place
    stop = "" if message.endswith("?") else "."
    return InputError(f"{path}: row {number}, token {shortened(token)}: {message}{stop}")


def dangling_error(path: Path, place: Place, field: str, token: str, table: str) -> InputError:
    """Return the error for a row whose `field` holds a token that another table does not have."""
    message = f"expected {field} to name a row of the table {table}; got {shortened(token)}, which it does not have"
    return row_error(path, place, message)


def repeated_error(path: Path, place: Place, first: int, unique: str = "token") -> InputError:
    """Return the error for a row with the same value of `unique` as the row `first`."""
    return row_error(path, place, f"expected each {unique} once; got that of row {first} again")


def _split_rows(path: Path, content: bytes) -> list[Raw]:
    """Return the text of each row, without a copy. Raises InputError if the content is not a JSON array."""
    try:
        return msgspec.json.decode(content, type=list[Raw])
    except PARSER_ERRORS as error:
        message = f"{path}: expected a JSON array of rows; got {len(content)} bytes that are not ({_describe(error)})"
        place = re.search(r"byte (\d+)", str(error))  # not for a truncated file
        last = _last_complete_row(content, int(place[1]) if place else len(content))
        raise InputError(f"{message}{last}. Unpack the file again.") from None


def _last_complete_row(content: bytes, end: int) -> str:
    """Describe the last row before the damage of a table. end: number of bytes before the damage."""
    for _ in range(MAX_ATTEMPTS):
        end = content.rfind(b"}", 0, end)
        if end < 0:
            break
        try:
            rows = msgspec.json.decode(content[: end + 1] + b"]", type=list[Raw])
        except PARSER_ERRORS:
            continue
        return f"; the last complete row is {len(rows) - 1}, token {shortened(_token_of(rows[-1]))}"
    return ""


def _token_of(raw: Raw) -> str:
    """Return the token of a row that may not be valid; empty if it has none."""
    try:
        return msgspec.json.decode(raw, type=Row).token
    except PARSER_ERRORS:
        return ""


def _describe(error: Exception) -> str:
    """Return the message of a parser, which may quote the file."""
    return printable(str(error).replace(" - at `$", " at `")).rstrip(".")
