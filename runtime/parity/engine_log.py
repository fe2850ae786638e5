"""An engine log: outputs that another engine computed from the inputs of a golden file, as NPZ or JSON."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from ..bundle.manifest import Manifest, TensorSpec
from ..errors import InputError
from ..json_record import JsonRecord, Name, read_json
from ..printable import shortened
from .golden_file import GoldenFile
from .golden_file_record import CaseRecord
from .npz_archive import NpzArchive

GOLDEN_SHA256 = "golden_sha256"  # an array of the NPZ form, and a field of the JSON form
_MAX_JSON_BYTES = 2**32
# JSON has no NaN. A value of null stands for it, so that a log can show that an engine returned NaN.
JsonNumber = Annotated[float, Field(strict=True)] | Annotated[bool, Field(strict=True)] | None
ReadTensor = Callable[[str, TensorSpec], NDArray]


class LoggedTensor(JsonRecord):
    """An output in the JSON form. values: in row-major order; null for NaN."""

    shape: tuple[int, ...]
    dtype: Literal["float32", "bool", "uint8"]
    values: tuple[JsonNumber, ...]


class EngineLogRecord(JsonRecord):
    """The JSON form of an engine log. outputs: by `CASE/OUTPUT`."""

    golden_sha256: Name
    outputs: dict[Name, LoggedTensor]


def read_engine_log(
    path: Path, golden: GoldenFile, manifest: Manifest, cases: Sequence[CaseRecord]
) -> dict[str, dict[str, NDArray]]:
    """Read the outputs of an engine log by case and output.

    cases: those that the log must have.
    Raises InputError, naming the file and the array, for a log of another golden file, missing or unknown outputs,
    other shapes and types, and a damaged file. NaN is not an error here.
    """
    if path.suffix.lower() == ".json":
        record = read_json(path, EngineLogRecord, InputError, _MAX_JSON_BYTES)
        _check_hash(path, record.golden_sha256, golden)
        return _read(
            path, set(record.outputs), manifest, cases, golden, lambda n, s: _from_json(path, n, record.outputs[n], s)
        )
    with NpzArchive(path, InputError) as archive:
        _check_hash(path, archive.read_text(GOLDEN_SHA256), golden)
        names = archive.names - {GOLDEN_SHA256}
        return _read(
            path, names, manifest, cases, golden, lambda name, spec: archive.read(name, spec.shape, _dtypes(spec))
        )


def _check_hash(path: Path, found: str, golden: GoldenFile) -> None:
    expected = golden.sha256()
    if found != expected:
        raise InputError(
            f"{path}: {GOLDEN_SHA256}: expected {expected[:12]}…, the hash of {golden.path}; got "
            f"{shortened(found[:12])}…. The log was made from another golden file: run the engine on this one."
        )


def _read(
    path: Path,
    names: set[str],
    manifest: Manifest,
    cases: Sequence[CaseRecord],
    golden: GoldenFile,
    read: ReadTensor,
) -> dict[str, dict[str, NDArray]]:
    specs = {
        case.name: {f"{case.name}/{spec.name}": spec for spec in manifest.graphs[case.graph].outputs} for case in cases
    }
    expected = {name for case in specs.values() for name in case}
    allowed = {f"{case.name}/{output}" for case in golden.cases for output in case.outputs}
    if missing := sorted(expected - names):
        raise InputError(
            f"{path}: expected the outputs of all cases of {golden.path}; {len(missing)} of {len(expected)} are "
            f"missing, the first {missing[0]!r}. Run the engine on every case."
        )
    if unknown := sorted(names - allowed):
        raise InputError(
            f"{path}: expected only outputs of {golden.path}, named CASE/OUTPUT; got {len(unknown)} others, the first "
            f"{shortened(unknown[0])}."
        )
    return {case: {spec.name: read(name, spec) for name, spec in tensors.items()} for case, tensors in specs.items()}


def _dtypes(spec: TensorSpec) -> tuple[str, ...]:
    return ("bool", "uint8") if spec.dtype == "bool" else (spec.dtype,)


def _from_json(path: Path, name: str, tensor: LoggedTensor, spec: TensorSpec) -> NDArray:
    if tensor.shape != spec.shape or tensor.dtype not in _dtypes(spec) or len(tensor.values) != np.prod(spec.shape):
        raise InputError(
            f"{path}: field outputs.{name}: expected {' or '.join(_dtypes(spec))} {spec.shape}; got {tensor.dtype} "
            f"{tensor.shape} with {len(tensor.values)} values."
        )
    values = np.array([np.nan if value is None else value for value in tensor.values], np.float64)
    return values.astype(tensor.dtype if not np.isnan(values).any() else np.float32).reshape(spec.shape)


def outputs_in_log(log: Mapping[str, Mapping[str, NDArray]]) -> Callable[[CaseRecord], Mapping[str, NDArray]]:
    """Return a function that looks up the outputs of a case."""
    return lambda case: log[case.name]
