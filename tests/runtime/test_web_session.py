"""onnxruntime-web as an engine: a process of Node.js that runs the graphs."""

import gc
import json
import signal
from pathlib import Path

import numpy as np
import pytest

from duospacenet.cli.main import run_app
from duospacenet.jobs.golden_check import check_golden_example
from duospacenet.runtime import Pipeline, web_session
from duospacenet.runtime.bundle.manifest import read_manifest
from duospacenet.runtime.errors import ArtifactError, MissingExtraError
from duospacenet.runtime.web_session import FOLDER_VARIABLE, WebProcess, WebSession, check_web_engine
from tests.helpers.bundles import edit_graph
from tests.helpers.web_engine import BROWSER_CONSUMER, web_engine  # noqa: F401  # a fixture

VERSION = json.loads((Path(web_session.__file__).parent / "web_engine" / "package.json").read_text())["dependencies"]


@pytest.mark.usefixtures("web_engine")
def test_the_golden_example_is_equal_in_webassembly(tiny_bundle):
    check = check_golden_example(tiny_bundle, engine="onnxruntime-web")
    assert check.difference is None
    assert check.engine["name"] == "onnxruntime-web"
    assert check.engine["version"]


@pytest.mark.usefixtures("web_engine")
def test_a_process_ends_with_its_pipeline_and_a_killed_one_is_an_error(tiny_bundle, frames):
    pipeline = Pipeline.load(tiny_bundle, threads=1, engine="onnxruntime-web")
    process = pipeline.sessions["decoder"]._process._process
    process.send_signal(signal.SIGKILL)
    with pytest.raises(ArtifactError, match=r"the graph failed to run: the Node\.js process .* ended: exit status -9"):
        pipeline.stream().step(frames[0])
    other = Pipeline.load(tiny_bundle, threads=1, engine="onnxruntime-web")
    process = other.sessions["decoder"]._process._process
    assert process.poll() is None
    del other
    gc.collect()
    assert process.poll() is not None


@pytest.mark.usefixtures("web_engine")
def test_a_graph_that_webassembly_refuses_is_named(copied_bundle):
    def unknown_operator(model):
        model.graph.node[-1].op_type = "NoSuchOperator"

    edit_graph(copied_bundle, "segmenter", unknown_operator)
    spec, path = read_manifest(copied_bundle).graphs["segmenter"], copied_bundle / "segmenter.onnx"
    with pytest.raises(ArtifactError, match=r"segmenter\.onnx: onnxruntime-web refuses the graph: .*NoSuchOperator"):
        WebSession(path.read_bytes(), spec, path, WebProcess(1))


@pytest.mark.usefixtures("web_engine")
def test_tensors_of_every_type_and_alignment_reach_the_graph(tiny_bundle):
    """The 1-byte tensors shift what follows them: typed arrays of JavaScript need aligned data."""
    path = tiny_bundle / "decoder.onnx"
    process = WebProcess(1)
    inputs, outputs = process.load("decoder", path.read_bytes())
    assert {dtype for _, _, dtype in inputs} == {"float32", "bool"}
    arrays = {name: np.ones(shape, dtype) for name, shape, dtype in sorted(inputs, key=lambda tensor: tensor[2])}
    found = process.run("decoder", arrays)
    assert {name: (value.shape, value.dtype.name) for name, value in found.items()} == {
        n: (s, d) for n, s, d in outputs
    }


def test_without_node_or_the_package_the_command_to_install_is_named(tiny_bundle, tmp_path, monkeypatch, capfd):
    monkeypatch.setenv(FOLDER_VARIABLE, str(tmp_path))
    command = ["parity", str(tiny_bundle), "--golden", "golden.npz", "--engine", "onnxruntime-web"]
    monkeypatch.setattr(web_session.shutil, "which", lambda name: "/usr/bin/node")
    assert run_app(command) == 6
    install = f"npm install --prefix '{tmp_path}' onnxruntime-web@{VERSION['onnxruntime-web']}"
    assert install in " ".join(capfd.readouterr().err.split())
    monkeypatch.setattr(web_session.shutil, "which", lambda name: None)
    with pytest.raises(MissingExtraError, match="apt-get install nodejs"):
        check_web_engine()


def test_the_version_is_that_of_the_browser_consumer():
    """CI installs the package once."""
    package = json.loads((BROWSER_CONSUMER / "package.json").read_text())
    assert package["dependencies"]["onnxruntime-web"] == VERSION["onnxruntime-web"]
