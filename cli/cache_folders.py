"""Folders that libraries create for caches, although the commands never fill them."""

import os


def keep_temporary_folder_clean() -> None:
    """Stop torch from creating an empty folder for compiled code in the temporary folder. The commands compile nothing.

    torch creates the folder that this variable names, so it names one that exists.
    """
    os.environ.setdefault("TORCHINDUCTOR_CACHE_DIR", os.environ.get("TMPDIR") or "/tmp")
