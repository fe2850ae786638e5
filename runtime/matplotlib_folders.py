"""matplotlib's folders in the home directory. Plots of this toolkit do not create them."""

import os
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

VARIABLE = "MPLCONFIGDIR"


@contextmanager
def temporary_matplotlib_folders() -> Iterator[None]:
    """Wrap imports of matplotlib, which creates folders for its configuration and its list of fonts when imported.

    Here it uses a temporary folder, which is removed afterwards. Nothing changes for a user who has these folders, has
    set MPLCONFIGDIR, or has already imported matplotlib.
    """
    if "matplotlib" in sys.modules or VARIABLE in os.environ or any(path.exists() for path in _user_folders()):
        yield
        return
    with tempfile.TemporaryDirectory() as folder:
        os.environ[VARIABLE] = folder
        try:
            yield
        finally:
            del os.environ[VARIABLE]


def _user_folders() -> list[Path]:
    try:
        home = Path.home()
    except RuntimeError:  # the user has no home directory
        return []
    bases = (os.environ.get("XDG_CONFIG_HOME") or home / ".config", os.environ.get("XDG_CACHE_HOME") or home / ".cache")
    return [Path(base) / "matplotlib" for base in bases]
