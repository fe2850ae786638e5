"""The anchors file: the initial positions of object queries, and the data that they were computed from."""

import math
import os
from pathlib import Path
from typing import Annotated, Final, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, ValidationInfo, field_validator
from pydantic_core import PydanticCustomError

from ..runtime.errors import ArtifactError, OutputError
from ..runtime.files import output_errors, remove_temporary, temporary_path, write_atomically
from ..runtime.json_record import FiniteFloat, JsonRecord, PositiveFloat, PositiveInt, read_json

SCHEMA_VERSION: Final = 1
LARGEST_RANGE_M = 1000.0

Centre = tuple[FiniteFloat, FiniteFloat, FiniteFloat]


class Anchors(JsonRecord):
    """The content of an anchors file.

    source: identity of the frame source.
    num_frames: number of frames with known boxes.
    num_boxes: number of boxes within `range_m` of the ego, which were clustered.
    range_m: largest distance of a box, and of an anchor, from the ego.
    seed: of the clustering.
    centres_m: x, y, z of each anchor in the ego frame.
    """

    schema_version: Literal[1]
    source: str
    num_frames: PositiveInt
    num_boxes: PositiveInt
    range_m: Annotated[PositiveFloat, Field(le=LARGEST_RANGE_M)]
    seed: Annotated[int, Field(strict=True, ge=0)]
    centres_m: Annotated[tuple[Centre, ...], Field(min_length=1)]  # must follow range_m, which its validator uses

    @field_validator("centres_m")
    @classmethod
    def _check_range(cls, centres_m: tuple[Centre, ...], others: ValidationInfo) -> tuple[Centre, ...]:
        range_m = others.data.get("range_m", math.inf)  # absent if range_m is wrong; then that error is reported
        for index, centre in enumerate(centres_m):
            if math.hypot(*centre) > range_m * (1 + 1e-6):
                raise PydanticCustomError(
                    "beyond_range",
                    f"expected each within range_m, {range_m:g} m, of the ego; index {index} is "
                    f"{math.hypot(*centre):g} m away",
                )
        return centres_m

    @property
    def centres(self) -> NDArray[np.float64]:
        """The anchors (Q, 3) [m] in the ego frame."""
        return np.array(self.centres_m, np.float64)


def write_anchors(path: Path, anchors: Anchors) -> None:
    """Write anchors to a new file, completely or not at all. Raises OutputError if it exists or cannot be written."""
    check_new_file(path)
    with output_errors(path):
        path.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(path, (anchors.model_dump_json() + "\n").encode())


def read_anchors(path: Path) -> Anchors:
    """Read an anchors file. Raises ArtifactError, naming the file and the field."""
    return read_json(path, Anchors, ArtifactError)


def check_new_file(path: Path) -> None:
    """Check that a new file can be written to `path`. Its folder may not exist yet. Nothing remains on disk.

    Raises OutputError if it cannot be written, or if `path` exists, even as a broken symbolic link.
    """
    if os.path.lexists(path):
        got = "it is a folder. Name a file in it" if path.is_dir() else "it exists already. Remove it"
        raise OutputError(f"{path}: expected a new file; {got}, or choose another --out.")
    folder = next(parent for parent in path.absolute().parents if os.path.lexists(parent))
    probe = temporary_path(folder / path.name)
    try:
        probe.touch()
    except OSError as error:
        raise OutputError(
            f"{path}: expected a place for a new file; {folder} is not writable ({error.strerror}). "
            "Choose another --out."
        ) from error
    finally:
        remove_temporary(probe)
