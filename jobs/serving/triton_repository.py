"""A model repository for Triton: a copy of a bundle, the model that runs it, its configuration, and a README.

OUT/README.md
OUT/check_sequences.py
OUT/NAME/config.pbtxt
OUT/NAME/1/model.py
OUT/NAME/1/bundle/
"""

import math
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ...runtime import Pipeline
from ...runtime.bundle.bundle_files import check_files
from ...runtime.bundle.manifest import MANIFEST_NAME, Manifest, read_manifest, slot_name
from ...runtime.errors import ArtifactError, OutputError, UsageError
from ...runtime.files import atomic_folder, output_errors
from ..folder_files import files_below
from .serving_options import ServingOptions
from .triton_config import config_text
from .triton_model import BUNDLE_FOLDER
from .triton_readme import readme_text

CONFIG_NAME = "config.pbtxt"
README_NAME = "README.md"
CHECK_NAME = "check_sequences.py"
VERSION = "1"  # of the model, for Triton
CACHE_NAME = "__pycache__"

MODEL_CODE = '''\
"""Runs the bundle beside this file, for many vehicles. Written by `duospacenet package triton`."""

import triton_python_backend_utils as pb_utils
from duospacenet.jobs.serving.triton_model import TritonModel


class TritonPythonModel:
    """What Triton's Python backend calls."""

    def initialize(self, args):
        self.model = TritonModel(pb_utils, args)

    def execute(self, requests):
        return self.model.execute(requests)
'''


@dataclass(frozen=True)
class TritonRepository:
    """A model repository that was written.

    state_mb: cached values of one vehicle with a full window [MB]. With a history step, a fast stream caches more.
    """

    out: Path
    options: ServingOptions
    state_mb: float

    def to_dict(self) -> dict[str, Any]:
        """The fields as JSON values."""
        return {"out": str(self.out), **vars(self.options), "state_mb": self.state_mb}


def package_triton(
    bundle: str | Path, out: str | Path, options: ServingOptions | None = None, *, overwrite: bool = False
) -> TritonRepository:
    """Write a model repository for Triton that serves a bundle.

    out: the folder to create.
    options: None for the defaults.
    overwrite: replace a repository that this function wrote.
    Raises ArtifactError for a bundle that `Pipeline.load` refuses, UsageError for options that do not fit it, and
    OutputError if `out` exists or cannot be written.
    """
    bundle, out, options = Path(bundle), Path(out), options or ServingOptions()
    _check_out(bundle, out, overwrite)
    _check_name(options.name)
    manifest = Pipeline.load(bundle).manifest
    options.check(manifest)
    with atomic_folder(out, replace=overwrite) as folder:
        _write(folder, bundle, manifest, options)
    return TritonRepository(out, options, _state_mb(manifest))


def _check_out(bundle: Path, out: Path, overwrite: bool) -> None:
    """Check that `out` does not exist, or that it may be replaced. Raises OutputError, and UsageError."""
    if out.resolve().is_relative_to(bundle.resolve()):
        raise UsageError(f"OUT: expected a folder outside the bundle; got {out}. Choose one beside the bundle.")
    if not (out.exists() or out.is_symlink()):
        return
    if not overwrite:
        raise OutputError(f"{out}: expected a new folder; it exists already. Choose another OUT, or add --overwrite.")
    if out.is_symlink() or not _is_repository(out):
        raise OutputError(
            f"{out}: expected a folder that `package triton` wrote, with no other files in it; got something else. "
            "Choose another OUT."
        )


def _check_name(name: str) -> None:
    """Check that the folder of the model and the files beside it have different names. Raises UsageError."""
    if name.lower() in {README_NAME.lower(), CHECK_NAME}:
        raise UsageError(f"--name: expected a name that no file of the repository has; got {name}. Choose another one.")


def _is_repository(out: Path) -> bool:
    """Whether a folder has the files of a model repository of ours and nothing else, apart from caches of Python."""
    with output_errors(out):
        names = {path.name for path in out.iterdir()} if out.is_dir() else set()
        models = names - {README_NAME, CHECK_NAME, CACHE_NAME}
        if len(models) != 1 or not {README_NAME, CHECK_NAME} <= names:
            return False
        model = out / models.pop()
        files = {path.relative_to(model).as_posix() for path in model.glob("*")} | {
            path.relative_to(model).as_posix() for path in model.glob(f"{VERSION}/*")
        }
    known = {CONFIG_NAME, VERSION, f"{VERSION}/model.py", f"{VERSION}/{BUNDLE_FOLDER}"}
    return known == files - {f"{VERSION}/{CACHE_NAME}"}


def _write(folder: Path, bundle: Path, manifest: Manifest, options: ServingOptions) -> None:
    model = folder / options.name
    _copy_bundle(bundle, model / VERSION / BUNDLE_FOLDER, manifest)
    (model / VERSION / "model.py").write_text(MODEL_CODE)
    (model / CONFIG_NAME).write_text(config_text(manifest, options))
    shutil.copyfile(Path(__file__).with_name(CHECK_NAME), folder / CHECK_NAME)
    (folder / README_NAME).write_text(readme_text(manifest, options), encoding="utf-8")


def _copy_bundle(bundle: Path, copy: Path, manifest: Manifest) -> None:
    """Copy all files of a bundle, and check the copy. Raises ArtifactError if the bundle has changed meanwhile."""
    for name in files_below(bundle):
        (copy / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(bundle / name, copy / name)
    check_files(copy, manifest)
    if read_manifest(copy) != manifest:
        raise ArtifactError(f"{bundle / MANIFEST_NAME}: changed while the bundle was copied. Try again.")


def _state_mb(manifest: Manifest) -> float:
    """The cached values of the past frames of one window [MB]."""
    shapes = {tensor.name: tensor.shape for tensor in manifest.graphs["decoder"].inputs}
    elements = sum(math.prod(shapes[slot_name(0, name)]) for name in manifest.memory)
    return 4 * elements * (manifest.window.num_frames - 1) / 1e6
