"""The names of the scenes' folders: safe on every file system, and different for every scene."""

import hashlib
import re
from collections import Counter
from collections.abc import Sequence

MAX_LENGTH = 80  # of the readable part; file systems take 255 bytes, with the suffixes that follow
_UNSAFE = re.compile(r"[^A-Za-z0-9._-]+")


def folder_names(scene_ids: Sequence[str]) -> list[str]:
    """Return a folder name for each id, in their order. Names differ by more than upper and lower case.

    An id is its own name if it is plain: ASCII letters, digits, ".", "_" and "-", at most MAX_LENGTH of them, the first
    a letter, a digit or "_". In any other id, the other characters become "_", and a hash of the id is appended. Ids
    that differ only in case also get a hash, for file systems that ignore case.

    scene_ids: all different.
    """
    plain = [_plain_name(scene_id) for scene_id in scene_ids]
    hashed = {scene_id for name, scene_id in zip(plain, scene_ids, strict=True) if name != scene_id}
    while True:
        names = [
            f"{name}-{_digest(scene_id)}" if scene_id in hashed else name
            for name, scene_id in zip(plain, scene_ids, strict=True)
        ]
        used = Counter(name.lower() for name in names)
        equal = {scene_id for name, scene_id in zip(names, scene_ids, strict=True) if used[name.lower()] > 1}
        if equal <= hashed:  # usually both are empty; a plain id may look like the hashed name of another one
            return names
        hashed |= equal


def _plain_name(scene_id: str) -> str:
    return _UNSAFE.sub("_", scene_id).lstrip(".-")[:MAX_LENGTH] or "scene"


def _digest(scene_id: str) -> str:
    return hashlib.sha256(scene_id.encode(errors="surrogatepass")).hexdigest()[:12]
