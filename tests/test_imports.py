"""The arrows of ARCHITECTURE.md: which package may import which, and what works where torch is not installed."""

import subprocess
import sys

import grimp
import pytest

TORCH = {"torch", "torchvision", "onnx", "onnxscript", "onnx_ir", "safetensors"}
WITHOUT_TORCH_PACKAGES = ("runtime", "data", "synthetic", "drawing", "rig", "evaluation")
MAY_IMPORT = {
    "model": set(),
    "runtime": set(),
    "data": {"runtime"},
    "synthetic": {"data", "runtime"},
    "drawing": {"runtime"},
    "rig": {"drawing", "data", "runtime"},
    "evaluation": {"data", "runtime"},
    "weights": {"model", "runtime"},
    "training": {"weights", "model", "synthetic", "evaluation", "data", "runtime"},
    "export": {"weights", "model", "synthetic", "data", "runtime"},
}
MAY_IMPORT["jobs"] = set(MAY_IMPORT)
MAY_IMPORT["cli"] = set(MAY_IMPORT)


@pytest.fixture(scope="module")
def graph() -> grimp.ImportGraph:
    """Every import in the toolkit, those inside functions included."""
    return grimp.build_graph("duospacenet", include_external_packages=True, exclude_type_checking_imports=True)


def modules_of(graph: grimp.ImportGraph, package: str) -> set[str]:
    return {f"duospacenet.{package}"} | graph.find_descendants(f"duospacenet.{package}")


def imported_by(graph: grimp.ImportGraph, module: str) -> set[str]:
    """The packages of the toolkit and the libraries that a module imports, each by one word."""
    imported = (name.split(".") for name in graph.find_modules_directly_imported_by(module))
    return {parts[1] if parts[0] == "duospacenet" and len(parts) > 1 else parts[0] for parts in imported}


def test_every_package_is_in_the_table(graph):
    children = {module.split(".")[1] for module in graph.find_children("duospacenet")}
    assert children == set(MAY_IMPORT)


def test_the_table_has_no_cycle():
    known: set[str] = set()
    for package, imported in MAY_IMPORT.items():
        assert imported <= known | {"model"}, package
        known.add(package)


@pytest.mark.parametrize("package", MAY_IMPORT)
def test_a_package_imports_only_the_packages_it_may(graph, package):
    modules = modules_of(graph, package)
    assert len(modules) > 1
    for module in modules:
        assert imported_by(graph, module) & set(MAY_IMPORT) <= MAY_IMPORT[package] | {package}, module


@pytest.mark.parametrize("package", WITHOUT_TORCH_PACKAGES)
def test_the_packages_that_run_a_bundle_never_import_torch_or_onnx(graph, package):
    for module in modules_of(graph, package):
        assert not imported_by(graph, module) & TORCH, module


def test_the_model_imports_neither_onnx_nor_opencv(graph):
    for module in modules_of(graph, "model"):
        assert not imported_by(graph, module) & {"onnxruntime", "onnx", "cv2"}, module


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
from duospacenet.synthetic.drive import SyntheticDrive

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
