"""Anchors: where object queries start, at K-means centroids of true boxes' centres in the ego frame; and their file."""

import math
import os
from pathlib import Path
from typing import Annotated, Final, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, ValidationInfo, field_validator
from pydantic_core import PydanticCustomError

from ..runtime.errors import ArtifactError, OutputError
from ..runtime.files import remove_temporary, temporary_path, write_atomically
from ..runtime.json_record import FiniteFloat, JsonRecord, PositiveFloat, PositiveInt, float64_array, read_json

SCHEMA_VERSION: Final = 1
LARGEST_RANGE_M = 1000.0

Array = NDArray[np.float64]
Labels = NDArray[np.int32]
Centre = tuple[FiniteFloat, FiniteFloat, FiniteFloat]


class Anchors(JsonRecord):
    """The file of anchors. centres_m: x, y, z of each in the ego frame.

    source: identity of the source; num_frames: those with true boxes; num_boxes: the boxes within range_m of the
    ego, whose centroids these are, and which lie within it as well; seed: of the clustering.
    """

    schema_version: Literal[1]
    source: str
    num_frames: PositiveInt
    num_boxes: PositiveInt
    range_m: Annotated[PositiveFloat, Field(le=LARGEST_RANGE_M)]
    seed: Annotated[int, Field(strict=True, ge=0)]
    centres_m: Annotated[tuple[Centre, ...], Field(min_length=1)]  # last: it is checked against range_m

    @field_validator("centres_m")
    @classmethod
    def _lie_within_range(cls, centres_m: tuple[Centre, ...], others: ValidationInfo) -> tuple[Centre, ...]:
        range_m = others.data.get("range_m", math.inf)  # where it is wrong itself, that is said
        for index, centre in enumerate(centres_m):
            if math.hypot(*centre) > range_m * (1 + 1e-6):
                raise PydanticCustomError(
                    "beyond_range",
                    f"expected each within range_m, {range_m:g} m, of the ego; index {index} is "
                    f"{math.hypot(*centre):g} m away",
                )
        return centres_m

    @property
    def centres(self) -> Array:
        """(Q, 3) [m]."""
        return float64_array(self.centres_m)


def write_anchors(path: Path, anchors: Anchors) -> None:
    """Write anchors to a new file, whole or not at all. Raises OutputError where it cannot be written."""
    check_new_file(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"cannot write {path}: {error.strerror}") from error
    write_atomically(path, (anchors.model_dump_json() + "\n").encode())


def read_anchors(path: Path) -> Anchors:
    """Read a file of anchors. Raises ArtifactError, naming the file and the field."""
    return read_json(path, Anchors, ArtifactError)


def check_new_file(path: Path) -> None:
    """See that a new file can be written at `path`, in a folder that is there or can be made; nothing stays behind.

    Raises OutputError, also where a link stands at `path` that leads nowhere.
    """
    if os.path.lexists(path):
        got = "it is a folder. Name a file in it" if path.is_dir() else "it exists already. Remove it"
        raise OutputError(f"{path}: expected a new file; {got}, or choose another --out.")
    place = next(folder for folder in path.absolute().parents if os.path.lexists(folder))
    probe = temporary_path(place / path.name)
    try:
        probe.touch()
    except OSError as error:
        raise OutputError(
            f"{path}: expected a place for a new file; {place} takes none ({error.strerror}). Choose another --out."
        ) from error
    finally:
        remove_temporary(probe)
