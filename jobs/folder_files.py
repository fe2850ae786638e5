"""The files of a bundle's folder, also those that the manifest does not name."""

import os
import stat
from pathlib import Path

from ..runtime.bundle.graph_file import MAX_FILE_BYTES
from ..runtime.errors import ArtifactError
from ..runtime.files import check_regular_file


def files_below(bundle: Path) -> tuple[str, ...]:
    """Return the paths of all files below a bundle's folder, relative to it and sorted.

    Raises ArtifactError for links, devices, files above the limit, and folders that cannot be read.
    """

    def refuse(error: OSError) -> None:
        raise ArtifactError(f"{error.filename}: cannot be read ({error.strerror}).")

    if not bundle.is_dir():
        raise ArtifactError(f"{bundle}: expected the folder of a bundle; got none.")
    files = []
    for folder, folders, names in os.walk(bundle, onerror=refuse):
        for path in (Path(folder) / name for name in (*folders, *names)):
            if path.is_symlink():
                raise ArtifactError(f"{path}: expected a file or a folder; got a symbolic link. Copy the file instead.")
            if not stat.S_ISDIR(path.lstat().st_mode):
                check_regular_file(path, MAX_FILE_BYTES, ArtifactError)
                files.append(path.relative_to(bundle).as_posix())
    return tuple(sorted(files))
