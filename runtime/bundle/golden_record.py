"""The golden example of a bundle: where its files are, and the values that a consumer must compute from them."""

from typing import Annotated, Final, Literal

from pydantic import AfterValidator, Field, field_validator
from pydantic.config import JsonDict
from pydantic_core import PydanticCustomError

from ..json_record import FiniteFloat, FirstVersion, JsonRecord, Name, PositiveInt

GOLDEN_FOLDER: Final = "golden"
GOLDEN_SCENE: Final = "golden/scene"
GOLDEN_EXPECTED: Final = "golden/expected.json"
GOLDEN_RESULTS: Final = "golden/results.jsonl"

MAX_VALUES: Final = 256  # of a sampled tensor
WHOLE_TENSORS: Final = frozenset({"decoder.class_logits", "decoder.boxes"})
# In place of a graph's name: tensors that the host computes before the graphs, and map probabilities after them.
INPUTS: Final = "inputs"
MAPS: Final = "maps"

_MAX_FILES = 4096

_SHA256: Final = "^[0-9a-f]{64}$"
Sha256 = Annotated[str, Field(pattern=_SHA256)]
Tolerance = Annotated[float, Field(strict=True, ge=0, allow_inf_nan=False)]
Size = Annotated[int, Field(strict=True, gt=0, le=2**31 - 1)]


def _check_path(path: str) -> str:
    folder, *parts = path.split("/")
    if folder != GOLDEN_FOLDER or not parts or any(part in ("", ".", "..") for part in parts) or "\\" in path:
        raise PydanticCustomError("path", f"expected a file below {GOLDEN_FOLDER}/")
    return path


# In a JSON Schema: no part of a path is empty, "." or "..", or has a backslash.
_PART = r"(?:[^/\\.][^/\\]*|\.[^/\\.][^/\\]*|\.\.[^/\\]+)"
GoldenPath = Annotated[
    Name, AfterValidator(_check_path), Field(json_schema_extra={"pattern": rf"^{GOLDEN_FOLDER}(?:/{_PART})+$"})
]
_REQUIRED_FILES = (GOLDEN_EXPECTED, GOLDEN_RESULTS, f"{GOLDEN_SCENE}/scene.json")


_HASHES_SCHEMA: JsonDict = {
    "properties": {path: {"type": "string", "pattern": _SHA256} for path in _REQUIRED_FILES},
    "required": [*_REQUIRED_FILES],
}


class GoldenRecord(JsonRecord):
    """The files of the golden example, as paths in the bundle's folder.

    scene: a scene folder with a few frames.
    expected: the tensors of every frame, see `ExpectedValues`.
    results: the lines of `results.jsonl` for these frames.
    sha256: the hash of each file, those of the scene folder included.
    """

    scene: Literal["golden/scene"] = GOLDEN_SCENE
    expected: Literal["golden/expected.json"] = GOLDEN_EXPECTED
    results: Literal["golden/results.jsonl"] = GOLDEN_RESULTS
    sha256: Annotated[dict[GoldenPath, Sha256], Field(max_length=_MAX_FILES, json_schema_extra=_HASHES_SCHEMA)]

    @field_validator("sha256")
    @classmethod
    def _check_files(cls, sha256: dict[str, str]) -> dict[str, str]:
        for path in _REQUIRED_FILES:
            if path not in sha256:
                raise PydanticCustomError("files", f"expected the hash of {path}; it is missing")
        return sha256


class ExpectedTensor(JsonRecord):
    """Some values of one tensor.

    step: `values[i]` is the element with the row-major index `i * step`. No axis has a common divisor with the step, so
        every index of every axis is sampled if there are enough values.
    compare: "each": no value may differ by more than `tolerance`. "rms": the root mean square of the differences of
        all compared values may not exceed `tolerance`. int8 bundles have it, because their rounding adds up.
    values: a bool is 0 or 1. None is a value that engines may leave undefined, and that is not compared.
    """

    shape: Annotated[tuple[Size, ...], Field(max_length=8)]
    dtype: Literal["float32", "uint8", "bool"]
    step: PositiveInt
    compare: Literal["each", "rms"]
    tolerance: Tolerance
    values: tuple[FiniteFloat | None, ...]


class ExpectedFrame(JsonRecord):
    """The tensors of one frame.

    token: of the frame.
    tensors: by name: `inputs.NAME` for those that the host computes, `GRAPH.NAME` for the outputs of the graphs, and
        `maps.NAME` (X, Y) for the probabilities of a map class.
    """

    token: Name
    tensors: dict[Name, ExpectedTensor]


class ResultTolerance(JsonRecord):
    """The largest accepted differences of a result line: of a box number [m, rad, m/s], and of a score.

    None in int8 bundles, in which boxes and scores are not compared.
    """

    box: Tolerance | None
    score: Tolerance | None


class ExpectedValues(JsonRecord):
    """The content of `golden/expected.json`.

    tolerance: of the lines in `golden/results.jsonl`; each tensor has its own.
    """

    schema_version: FirstVersion
    tolerance: ResultTolerance
    frames: tuple[ExpectedFrame, ...]
