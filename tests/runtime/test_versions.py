"""Versions come from modules, so they do not depend on the distributions that provide the modules."""

import json
from importlib.metadata import Distribution, PackageNotFoundError

import cv2
import onnx
import onnxruntime
import pytest

from duospacenet import __version__
from duospacenet.cli.main import run_app
from duospacenet.export.manifest_builder import LIBRARIES
from duospacenet.model import PRESETS
from duospacenet.runtime.versions import library_versions
from duospacenet.training import Settings, TrainingRecord


@pytest.fixture
def without_distributions(monkeypatch):
    """No distribution has metadata, as if each module came from a distribution with another name."""

    def from_name(name):
        raise PackageNotFoundError(name)

    monkeypatch.setattr(Distribution, "from_name", from_name)


def test_a_run_records_versions_without_metadata_of_distributions(without_distributions, tiny_bundle, tmp_path):
    assert run_app(["run", str(tiny_bundle), "synthetic:5:1", "--out", str(tmp_path)]) == 0
    recorded = json.loads((tmp_path / "run.json").read_text())
    assert recorded["duospacenet"] == __version__
    assert recorded["onnxruntime"] == onnxruntime.__version__
    assert recorded["opencv"] == cv2.__version__


def test_the_versions_in_a_manifest_need_no_metadata_of_distributions(without_distributions):
    versions = library_versions(LIBRARIES)
    assert versions.keys() == {"duospacenet", "torch", "onnx", "onnx-ir", "onnxscript", "onnxruntime"}
    assert versions["onnx"] == onnx.__version__
    assert "unknown" not in versions.values()


def test_a_training_records_versions_without_metadata_of_distributions(without_distributions):
    record = TrainingRecord(PRESETS["tiny"], Settings(steps=2), "synthetic", "0" * 64)
    assert record.metadata(1)["duospacenet"] == __version__


def test_a_module_without_a_version_is_recorded_as_unknown(tmp_path, monkeypatch):
    (tmp_path / "nameless_build.py").touch()
    monkeypatch.syspath_prepend(tmp_path)
    assert library_versions(["nameless_build"]) == {"nameless_build": "unknown"}
