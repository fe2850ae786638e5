"""Hash trailer: the last line of a file, with the sha256 of all bytes before it.

The hash is part of the file, so both are replaced by one rename. After an interruption at any moment, the file has the
hash of its own content. `torch.load` ignores bytes after the end of the archive.
"""

import hashlib
import os
from pathlib import Path
from typing import BinaryIO

MARKER = b"\nsha256 "
TRAILER_BYTES = len(MARKER) + 64 + 1


def append_hash(path: Path) -> None:
    """Append the trailer to a file."""
    with path.open("rb+") as file:
        digest = hashlib.file_digest(file, "sha256").hexdigest()
        file.seek(0, os.SEEK_END)
        file.write(_trailer(digest))


def check_hash(file: BinaryIO) -> None:
    """Check the trailer of a file, and set the position to its start.

    Raises ValueError if the trailer is missing, or if the content before it has another hash.
    """
    size = file.seek(0, os.SEEK_END)
    content_size = max(0, size - TRAILER_BYTES)
    file.seek(0)
    digest = hashlib.sha256()
    while block := file.read(min(2**20, content_size - file.tell())):
        digest.update(block)
    trailer = file.read()
    if not trailer.startswith(MARKER):
        raise ValueError(f"{size} bytes without a sha256 at their end, so the file is truncated or from before 0.3.0")
    if trailer != _trailer(digest.hexdigest()):
        raise ValueError(f"{size} bytes that do not match the sha256 at their end, so the file is damaged")
    file.seek(0)


def _trailer(digest: str) -> bytes:
    return MARKER + digest.encode() + b"\n"
