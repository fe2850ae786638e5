"""The trained weights of this project. The metadata of each file says how it was trained.

The files are not in the toolkit's wheel. They are in a checkout, and in the distribution `duospacenet-weights`.
"""

from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path

from ..runtime.errors import MissingExtraError

SHIPPED = ("nano",)
PACKAGE = "duospacenet_weights"  # of the distribution, in the folder `weights_package`


def shipped_weights(preset: str) -> Path:
    """The safetensors file with the trained weights of `preset`.

    Raises FileNotFoundError for a preset without trained weights, and MissingExtraError if they are not installed.
    """
    if preset not in SHIPPED:
        raise FileNotFoundError(f"expected a preset with trained weights, {', '.join(SHIPPED)}; got {preset!r}")
    for folder in _folders():
        path = folder / f"{preset}.safetensors"
        if path.is_file():
            return path
    raise MissingExtraError(
        f"expected the trained weights of {preset}; they are not installed. "
        "Install them in a clone of the repository: pip install ./weights_package"
    )


def _folders() -> Iterator[Path]:
    """The folder of this file, which holds the weights in a checkout, and that of the distribution, if installed."""
    yield Path(__file__).parent
    package = find_spec(PACKAGE)
    if package is not None:
        yield from map(Path, package.submodule_search_locations or ())
