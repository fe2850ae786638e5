"""onnxruntime-web (WebAssembly) as an engine, in a process of Node.js. It is for proofs: it copies every tensor.

A browser runs the same WebAssembly. Node.js and the npm package are no part of the Python package.
"""

import json
import os
import shutil
import subprocess
import tempfile
import threading
import weakref
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, Final, cast

import numpy as np
import onnxruntime as ort
from numpy.typing import NDArray

from .bundle.manifest import GraphSpec
from .errors import ArtifactError, MissingExtraError
from .printable import printable
from .session import TensorDescription, Tensors, check_tensors
from .termination import terminable

FOLDER_VARIABLE: Final = "DUOSPACENET_ONNXRUNTIME_WEB"  # the folder whose node_modules holds onnxruntime-web
_RUNNER: Final = Path(__file__).parent / "web_engine"


def web_package_folder() -> Path:
    """Return the folder in whose `node_modules` onnxruntime-web is looked for.

    It is `$DUOSPACENET_ONNXRUNTIME_WEB`, or `duospacenet/web` in `$XDG_CACHE_HOME` or `~/.cache`.
    """
    if folder := os.environ.get(FOLDER_VARIABLE):
        return Path(folder)
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "duospacenet" / "web"


def check_web_engine() -> None:
    """Check that Node.js and onnxruntime-web are installed. Raises MissingExtraError with the command to install."""
    folder, package = web_package_folder(), _package()
    if shutil.which("node") is None:
        raise MissingExtraError(
            "expected Node.js 20 or later, which runs onnxruntime-web; there is no command `node`. Install it, for "
            "example: apt-get install nodejs npm"
        )
    if not (folder / "node_modules" / "onnxruntime-web").is_dir():
        raise MissingExtraError(
            f"expected the npm package onnxruntime-web in {folder}; it is not installed. "
            f"Install it: npm install --prefix '{folder}' {package}"
        )


class WebProcess:
    """A process of Node.js with onnxruntime-web. Its sessions run one after the other."""

    def __init__(self, threads: int) -> None:
        """threads: of WebAssembly. Raises MissingExtraError, and ArtifactError if the process does not start."""
        check_web_engine()
        self._lock = threading.Lock()
        self._errors = tempfile.TemporaryFile()  # noqa: SIM115  # closed with this object
        command = ["node", str(_RUNNER / "runner.mjs"), str(web_package_folder()), str(threads)]
        # In a new session, so Ctrl-C does not reach Node.js. Node.js ends when its stdin is closed.
        self._process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=self._errors, start_new_session=True
        )
        weakref.finalize(self, _end, self._process)
        self.version = str(self._read_line()["version"])

    def load(self, name: str, graph: bytes) -> tuple[list[TensorDescription], list[TensorDescription]]:
        """Load a graph; return its inputs and outputs. Raises ArtifactError."""
        with self._lock, terminable(self._process.kill):
            self._write({"load": name, "bytes": len(graph)}, [graph])
            reply = self._read_line()
            return _descriptions(reply["inputs"]), _descriptions(reply["outputs"])

    def run(self, name: str, inputs: Mapping[str, NDArray]) -> dict[str, NDArray]:
        """Run a graph; return its outputs. Raises ArtifactError."""
        specs = [{"name": key, "dtype": value.dtype.name, "shape": list(value.shape)} for key, value in inputs.items()]
        with self._lock, terminable(self._process.kill):
            self._write({"run": name, "inputs": specs}, [np.ascontiguousarray(value).data for value in inputs.values()])
            descriptions = _descriptions(self._read_line()["outputs"])
            return {key: self._read_array(shape, dtype) for key, shape, dtype in descriptions}

    def _write(self, request: dict[str, Any], parts: Sequence[bytes | memoryview]) -> None:
        stdin = cast(Any, self._process.stdin)
        try:
            stdin.write(json.dumps(request).encode() + b"\n")
            for part in parts:
                stdin.write(part)
            stdin.flush()
        except BrokenPipeError:
            raise self._failure() from None

    def _read_line(self) -> dict[str, Any]:
        line = cast(Any, self._process.stdout).readline()
        if not line:
            raise self._failure()
        reply = json.loads(line)
        if "error" in reply:
            raise ArtifactError(printable(str(reply["error"])))
        return cast(dict[str, Any], reply)

    def _read_array(self, shape: tuple[int, ...], dtype: str) -> NDArray:
        array = np.empty(shape, dtype)
        view = array.data.cast("B") if array.size else memoryview(b"")
        if cast(Any, self._process.stdout).readinto(view) != array.nbytes:
            raise self._failure()
        return array

    def _failure(self) -> ArtifactError:
        self._process.wait()
        self._errors.seek(0)
        lines = [line for line in self._errors.read().decode(errors="replace").splitlines() if "rror" in line]
        text = printable(lines[0].strip()) if lines else f"exit status {self._process.returncode}"
        return ArtifactError(f"the Node.js process of onnxruntime-web ended: {text[:300]}")


class WebSession:
    """A graph in onnxruntime-web; see `session.Session`."""

    precision = "float32"

    def __init__(self, graph: bytes, spec: GraphSpec, path: Path, process: WebProcess) -> None:
        """Load a graph and compare its inputs and outputs with `spec`.

        graph: the content of its file, which has been checked. path: the file, for messages.
        Raises ArtifactError if onnxruntime-web rejects the graph, or if a name, shape or dtype differs.
        """
        self._process, self._path, self._spec = process, path, spec
        try:
            inputs, outputs = process.load(str(path), graph)
        except ArtifactError as error:
            raise ArtifactError(f"{path}: onnxruntime-web refuses the graph: {error}") from error
        check_tensors(path, "inputs", inputs, spec.inputs)
        check_tensors(path, "outputs", outputs, spec.outputs)

    @property
    def version(self) -> str:
        """The version of onnxruntime-web."""
        return self._process.version

    def run(self, tensors: Mapping[str, ort.OrtValue]) -> Tensors:
        """Run the graph; see `session.Session.run`."""
        inputs = {spec.name: tensors[spec.name].numpy() for spec in self._spec.inputs}
        try:
            arrays = self._process.run(str(self._path), inputs)
        except ArtifactError as error:
            raise ArtifactError(f"{self._path}: the graph failed to run: {error}") from error
        outputs = {
            spec.name: ort.OrtValue.ortvalue_from_shape_and_type(spec.shape, np.dtype(spec.dtype).type)
            for spec in self._spec.outputs
        }
        for spec in self._spec.outputs:
            outputs[spec.name].numpy()[...] = arrays[spec.name]
        return outputs


def _descriptions(tensors: Sequence[Mapping[str, Any]]) -> list[TensorDescription]:
    return [(str(tensor["name"]), tuple(tensor["shape"]), str(tensor["dtype"])) for tensor in tensors]


def _package() -> str:
    """The npm package with its version, for `npm install`."""
    dependencies = json.loads((_RUNNER / "package.json").read_text())["dependencies"]
    return " ".join(f"{name}@{version}" for name, version in dependencies.items())


def _end(process: subprocess.Popen) -> None:
    process.kill()
    process.wait()
    for pipe in (process.stdin, process.stdout):
        with suppress(BrokenPipeError):
            cast(Any, pipe).close()
