"""The shipped weights: in a checkout, in the distribution `duospacenet-weights`, or missing."""

import subprocess
import sys
from pathlib import Path

import pytest

from duospacenet.cli.main import run_app
from duospacenet.weights import shipped, shipped_weights


@pytest.fixture
def not_in_a_checkout(tmp_path, monkeypatch):
    """The toolkit is installed from its wheel, and the distribution of the weights is not installed."""
    monkeypatch.setattr(shipped, "__file__", str(tmp_path / "wheel" / "shipped.py"))
    monkeypatch.setattr(shipped, "PACKAGE", "duospacenet_weights_of_a_test")


def test_a_checkout_has_the_weights():
    assert shipped_weights("nano").samefile(Path(__file__).parents[2] / "weights" / "nano.safetensors")


def test_the_weights_are_found_in_the_installed_distribution(not_in_a_checkout, tmp_path, monkeypatch):
    package = tmp_path / "site-packages" / "duospacenet_weights_of_a_test"
    package.mkdir(parents=True)
    (package / "__init__.py").write_text("raise RuntimeError('the package is not imported')")
    (package / "nano.safetensors").touch()
    monkeypatch.syspath_prepend(package.parent)
    assert shipped_weights("nano") == package / "nano.safetensors"


def test_without_them_the_demo_names_the_command_that_installs_them(not_in_a_checkout, tmp_path, capfd):
    assert run_app(["demo", "--out", str(tmp_path / "demo")]) == 6
    printed = capfd.readouterr()
    assert "trained weights of nano" in printed.err
    assert "pip install ./weights_package" in printed.err
    assert not (tmp_path / "demo").exists()


WITHOUT_PYTORCH = """
import sys
sys.modules["torch"] = None  # an import raises ImportError
from duospacenet.cli.main import main
main()
"""


def test_without_pytorch_the_demo_names_the_extra_export(tmp_path):
    command = [sys.executable, "-c", WITHOUT_PYTORCH, "demo", "--out", tmp_path / "demo"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 6
    assert "pip install 'duospacenet[export]'" in done.stderr


def test_a_preset_without_trained_weights_is_refused():
    with pytest.raises(FileNotFoundError, match="with trained weights, nano; got 'tiny'"):
        shipped_weights("tiny")
