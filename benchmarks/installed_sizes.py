"""The size of an environment's installed files by distribution, largest first.

Usage: PYTHON benchmarks/installed_sizes.py

PYTHON is the interpreter of the environment. No package is needed. Sizes are in MB of 10^6 bytes.
"""

import os
import sysconfig
from collections.abc import Iterable
from importlib.metadata import Distribution, distributions
from pathlib import Path

OTHER = "no distribution"  # mostly bytecode that an import has written


def main() -> None:
    sizes = installed_sizes(Path(sysconfig.get_path("purelib")))
    for name, size in sorted(sizes.items(), key=lambda row: -row[1]):
        print(f"{name:<34}{size / 1e6:8.1f} MB")
    print(f"{'total':<34}{sum(sizes.values()) / 1e6:8.1f} MB")


def installed_sizes(site_packages: Path) -> dict[str, int]:
    """The bytes of each distribution in a folder `site-packages`, by "NAME VERSION", and of files of no distribution.

    A file that two distributions list is counted once. A distribution's commands outside the folder are included.
    """
    sizes, counted = {}, set()
    for distribution in distributions(path=[str(site_packages)]):
        files = _files(distribution) - counted
        counted |= files
        sizes[f"{distribution.metadata['Name']} {distribution.version}"] = _size(files)
    every = {Path(folder, name) for folder, _, names in os.walk(site_packages.resolve()) for name in names}
    return sizes | {OTHER: _size(every - counted)}


def _files(distribution: Distribution) -> set[Path]:
    paths = (Path(str(file.locate())).resolve() for file in distribution.files or ())
    return {path for path in paths if path.is_file()}


def _size(files: Iterable[Path]) -> int:
    return sum(path.lstat().st_size for path in files)


if __name__ == "__main__":
    main()
