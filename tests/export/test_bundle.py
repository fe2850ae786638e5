"""`export_bundle`: the files that it writes, and the cases in which it writes nothing."""

from pathlib import Path

import onnx
import pytest
from onnx import numpy_helper

from duospacenet.export import ParityError, bundle, export_bundle
from duospacenet.model import PRESETS, DuoSpaceNet, randomise
from duospacenet.runtime.errors import OutputError
from tests.helpers.parity_results import passing_result

ROOT = Path(__file__).resolve().parents[2]
GRAPHS = ["backbone.onnx", "decoder.onnx", "lifter.onnx", "projector.onnx", "segmenter.onnx"]


def test_a_bundle_is_five_graphs_a_manifest_and_a_golden_example(tiny_bundle):
    assert sorted(path.name for path in tiny_bundle.iterdir()) == sorted([*GRAPHS, "golden", "manifest.json"])


@pytest.mark.parametrize("graph", GRAPHS)
def test_a_graph_is_one_file_with_standard_operators_and_without_source_paths(tiny_bundle, graph):
    model = onnx.load(tiny_bundle / graph, load_external_data=False)
    onnx.checker.check_model(model, full_check=True)
    assert [(opset.domain, opset.version) for opset in model.opset_import] == [("", 19)]
    assert not model.functions
    assert all(tensor.data_location != onnx.TensorProto.EXTERNAL for tensor in model.graph.initializer)
    assert not model.metadata_props
    assert not any(node.metadata_props or node.doc_string for node in model.graph.node)
    content = (tiny_bundle / graph).read_bytes()
    assert str(ROOT).encode() not in content
    assert b"site-packages" not in content
    assert b".py" not in content


def test_other_weights_change_every_graph_except_the_projector(tiny_bundle, tmp_path, monkeypatch):
    written = {}
    monkeypatch.setattr(
        bundle, "check_parity", lambda folder, *_, **__: written.update(file_contents(folder)) or passing_result()
    )
    export_bundle(randomise(DuoSpaceNet(PRESETS["tiny"]), seed=1), tmp_path / "other")
    tiny = file_contents(tiny_bundle)
    assert {name for name in tiny if tiny[name] == written[name]} == {"projector.onnx"}


def test_a_graph_that_differs_from_the_model_is_not_written(reuse_traced_graphs, tiny_model, tmp_path, monkeypatch):
    monkeypatch.setattr(bundle, "trace", with_one_weight_changed(bundle.trace))
    with pytest.raises(ParityError, match=r"segmenter\.drivable_area, frame \d+: relative error") as failure:
        export_bundle(tiny_model, tmp_path / "bundle")
    assert failure.value.exit_code == 1
    assert not failure.value.result.passed
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("error", [KeyboardInterrupt, RuntimeError, OSError])
def test_an_interrupted_export_leaves_no_files(tiny_model, tmp_path, monkeypatch, error):
    def write_half_and_fail(graph, path, forms):
        path.write_bytes(b"half a graph")
        raise error

    monkeypatch.setattr(bundle, "trace", write_half_and_fail)
    with pytest.raises(error):
        export_bundle(tiny_model, tmp_path / "bundle")
    assert list(tmp_path.iterdir()) == []


def test_an_existing_folder_is_not_overwritten(tiny_model, tmp_path):
    (tmp_path / "bundle").mkdir()
    with pytest.raises(OutputError, match="expected a new folder; it exists already"):
        export_bundle(tiny_model, tmp_path / "bundle")


def with_one_weight_changed(trace):
    def trace_and_change(graph, path, forms):
        trace(graph, path, forms)
        if graph.name == "segmenter":
            model = onnx.load(path)
            bias = next(tensor for tensor in model.graph.initializer if tensor.name.endswith("drivable_area.3.bias"))
            bias.CopyFrom(numpy_helper.from_array(numpy_helper.to_array(bias) * 1.001 + 1e-3, bias.name))
            onnx.save(model, path)

    return trace_and_change


def file_contents(folder: Path) -> dict[str, bytes]:
    return {name: (folder / name).read_bytes() for name in GRAPHS}
