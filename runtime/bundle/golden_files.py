"""The files of a bundle's golden example: read, written, and checked by their hashes."""

import hashlib
import json
import os
from pathlib import Path

from ..errors import ArtifactError
from ..files import read_regular_file, write_atomically
from ..json_record import read_json
from ..printable import printable
from .golden_record import GOLDEN_EXPECTED, GOLDEN_FOLDER, ExpectedValues, GoldenRecord
from .manifest import MANIFEST_NAME, Manifest

MAX_GOLDEN_FILE_BYTES = 2**27


def check_golden_files(bundle: Path, manifest: Manifest) -> None:
    """Check the hash of each file of the golden example, and that its folder has no other files.

    A bundle without a golden example must not have its folder. Raises ArtifactError, naming the file.
    """
    recorded = {} if manifest.golden is None else manifest.golden.sha256
    for path in sorted(_files_below(bundle) | recorded.keys()):
        _check_file(bundle, path, recorded.get(path))


def read_expected_values(bundle: Path, record: GoldenRecord) -> ExpectedValues:
    """Read the expected values of a golden example. Raises ArtifactError, naming the file and the field."""
    return read_json(bundle / record.expected, ExpectedValues, ArtifactError, MAX_GOLDEN_FILE_BYTES)


def write_expected_values(bundle: Path, expected: ExpectedValues) -> None:
    """Write `golden/expected.json`, with one line per tensor. Raises OutputError."""
    values = expected.model_dump(mode="json")
    frames = []
    for frame in values["frames"]:
        lines = [f"   {json.dumps(name)}: {json.dumps(tensor)}" for name, tensor in frame["tensors"].items()]
        frames.append(f'  {{"token": {json.dumps(frame["token"])}, "tensors": {{\n' + ",\n".join(lines) + "\n  }}")
    head = f'{{\n "schema_version": {values["schema_version"]},\n "tolerance": {json.dumps(values["tolerance"])},\n'
    text = head + ' "frames": [\n' + ",\n".join(frames) + "\n ]\n}\n"
    write_atomically(bundle / GOLDEN_EXPECTED, text.encode())


def hash_golden_files(bundle: Path) -> GoldenRecord:
    """Return the manifest's entry for the golden example in a bundle's folder."""
    hashes = {path: hashlib.sha256((bundle / path).read_bytes()).hexdigest() for path in sorted(_files_below(bundle))}
    return GoldenRecord(sha256=hashes)


def _check_file(bundle: Path, path: str, expected: str | None) -> None:
    if expected is None:
        raise ArtifactError(
            f"{printable(str(bundle / path))}: expected only the files that {MANIFEST_NAME} lists; got another one. "
            "Remove it, or copy the bundle again."
        )
    digest = hashlib.sha256(read_regular_file(bundle / path, MAX_GOLDEN_FILE_BYTES, ArtifactError)).hexdigest()
    if digest != expected:
        raise ArtifactError(
            f"{bundle / path}: field golden.sha256: expected {expected[:12]!r}…, got {digest[:12]!r}…. "
            "The file is damaged or belongs to another bundle: copy the whole folder, or export again."
        )


def _files_below(bundle: Path) -> set[str]:
    """The paths of all files, links and special files below the golden example's folder."""
    top = bundle / GOLDEN_FOLDER
    if top.is_symlink() or (top.exists() and not top.is_dir()):
        return {GOLDEN_FOLDER}
    found = set()
    for folder, folders, files in os.walk(top):
        for name in (*files, *(name for name in folders if (Path(folder) / name).is_symlink())):
            found.add((Path(folder) / name).relative_to(bundle).as_posix())
    return found
