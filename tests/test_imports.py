"""Which part of the house may import which, read from the source; and the runtime where torch is not installed."""

import ast
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
TORCH = {"torch", "torchvision", "onnx", "onnxscript", "onnx_ir", "safetensors"}
MAY_IMPORT = {
    "model": set(),
    "runtime": set(),
    "training": {"model", "runtime"},
    "export": {"model", "runtime"},
    "evaluation": {"runtime"},
    "weights": set(),
    "cli": {"model", "runtime", "training", "export", "evaluation", "weights"},
}


def files_of(package: str) -> list[Path]:
    return sorted((ROOT / package).rglob("*.py"))


def imported_modules(path: Path, top_level_only: bool = False) -> Iterator[str]:
    """Full names of what a file imports; relative imports as `duospacenet.<package>...`.

    What stands under `if TYPE_CHECKING` is not imported. Functions are left out where only the top level is asked for.
    """
    package = ["duospacenet", *path.relative_to(ROOT).parent.parts]
    for node in _statements(ast.parse(path.read_text()), top_level_only):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            above = package[: len(package) - node.level + 1] if node.level else []
            module = ".".join([*above, *([node.module] if node.module else [])])
            yield module
            yield from (f"{module}.{alias.name}" for alias in node.names)


def _statements(tree: ast.AST, top_level_only: bool) -> Iterator[ast.AST]:
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
            continue
        yield node
        if not (top_level_only and isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef, ast.Lambda))):
            yield from _statements(node, top_level_only)


def house_part(module: str) -> str | None:
    """`model`, `runtime`, ... for a module of ours."""
    first, _, rest = module.partition(".")
    return rest.split(".")[0] or None if first == "duospacenet" else None


def test_the_packages_of_the_house_are_where_this_test_looks():
    for package in MAY_IMPORT:
        assert len(files_of(package)) > 0


@pytest.mark.parametrize("package", MAY_IMPORT)
def test_a_package_imports_only_what_it_may(package):
    for path in files_of(package):
        parts = {house_part(module) for module in imported_modules(path)} & MAY_IMPORT.keys()
        assert parts - {package} <= MAY_IMPORT[package], path


def test_the_runtime_never_imports_torch_or_onnx():
    for path in files_of("runtime"):
        assert not {module.split(".")[0] for module in imported_modules(path)} & TORCH, path


def test_the_model_imports_no_runtime_of_graphs():
    for path in files_of("model"):
        assert not {module.split(".")[0] for module in imported_modules(path)} & {"onnxruntime", "onnx", "cv2"}, path


def test_the_command_line_imports_what_is_heavy_inside_its_commands():
    for path in files_of("cli"):
        modules = list(imported_modules(path, top_level_only=True))
        assert not {module.split(".")[0] for module in modules} & TORCH, path
        assert not {house_part(module) for module in modules} & {"model", "export", "training"}, path


@pytest.mark.parametrize(
    ("source", "expected"),
    [
        ("from . import a", {"duospacenet.runtime.sources.a"}),
        ("from ..frame import Frame", {"duospacenet.runtime.frame"}),
        ("from ...model import x", {"duospacenet.model"}),
        ("import duospacenet.model.config", {"duospacenet.model.config"}),
        ("def f():\n  if x:\n    import torch.nn", {"torch.nn"}),
        ("class A:\n  def f(self):\n    from torch import nn", {"torch"}),
    ],
)
def test_this_test_sees_every_kind_of_import(tmp_path, monkeypatch, source, expected):
    monkeypatch.setattr(sys.modules[__name__], "ROOT", tmp_path)
    folder = tmp_path / "runtime" / "sources"
    folder.mkdir(parents=True)
    (folder / "x.py").write_text(source)
    assert expected <= set(imported_modules(folder / "x.py"))


WITHOUT_TORCH = """
import sys
from importlib.abc import MetaPathFinder

class Blocker(MetaPathFinder):
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in {blocked}:
            raise ImportError(f"{{name}} is not installed")

sys.meta_path.insert(0, Blocker())
try:
    import torch
except ImportError:
    pass
else:
    raise SystemExit("torch was not blocked")

from duospacenet.runtime import Pipeline
from duospacenet.runtime.sources.synthetic import SyntheticDrive

stream = Pipeline.load(sys.argv[1]).stream(maps=True)
for frame in SyntheticDrive(1, frames=5, image_size=(160, 64)):
    detections = stream.step(frame)
    print(detections.history.frames, len(detections))
assert not {blocked} & {{name.split(".")[0] for name in sys.modules}}
"""


def test_the_runtime_works_where_torch_is_not_installed(tiny_bundle):
    code = WITHOUT_TORCH.format(blocked=TORCH)
    done = subprocess.run([sys.executable, "-c", code, tiny_bundle], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert done.stdout.split("\n") == ["1 320", "2 320", "3 320", "4 320", "4 320", ""]
