"""Export as a whole: what is written, when nothing is written, and that the same weights give the same bytes."""

from pathlib import Path

import onnx
import pytest
from onnx import numpy_helper

from duospacenet.export import ParityError, ParityResult, bundle, export_bundle
from duospacenet.model import PRESETS, DuoSpaceNet, randomise
from duospacenet.runtime.errors import OutputError

ROOT = Path(__file__).resolve().parents[2]
GRAPHS = ["backbone.onnx", "decoder.onnx", "lifter.onnx", "projector.onnx", "segmenter.onnx"]


def test_a_bundle_is_five_graphs_and_a_manifest(tiny_bundle):
    assert sorted(path.name for path in tiny_bundle.iterdir()) == [*GRAPHS[:3], "manifest.json", *GRAPHS[3:]]


@pytest.mark.parametrize("graph", GRAPHS)
def test_a_graph_has_standard_operators_one_file_and_no_trace_of_its_making(tiny_bundle, graph):
    model = onnx.load(tiny_bundle / graph, load_external_data=False)
    onnx.checker.check_model(model, full_check=True)
    assert [(opset.domain, opset.version) for opset in model.opset_import] == [("", 20)]
    assert not model.functions
    assert all(tensor.data_location != onnx.TensorProto.EXTERNAL for tensor in model.graph.initializer)
    assert not model.metadata_props
    assert not any(node.metadata_props or node.doc_string for node in model.graph.node)
    content = (tiny_bundle / graph).read_bytes()
    assert str(ROOT).encode() not in content
    assert b"site-packages" not in content
    assert b".py" not in content


def test_other_weights_give_other_graphs_wherever_there_are_weights(tiny_bundle, tmp_path, monkeypatch):
    traced = {}
    monkeypatch.setattr(bundle, "check_parity", lambda folder, *_, **__: traced.update(hashes(folder)) or _passed())
    export_bundle(randomise(DuoSpaceNet(PRESETS["tiny"]), seed=1), tmp_path / "other")
    before = hashes(tiny_bundle)
    assert {name for name in before if before[name] == traced[name]} == {"projector.onnx"}


def test_a_graph_that_differs_from_the_model_is_not_written(reuse_traced_graphs, tiny_model, tmp_path, monkeypatch):
    monkeypatch.setattr(bundle, "trace", with_one_weight_changed(bundle.trace))
    with pytest.raises(ParityError, match=r"segmenter\.drivable_area, frame \d+: relative error") as failure:
        export_bundle(tiny_model, tmp_path / "bundle")
    assert failure.value.exit_code == 1
    assert not failure.value.report.passed
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("error", [KeyboardInterrupt, RuntimeError, OSError])
def test_an_export_that_breaks_off_leaves_nothing_behind(tiny_model, tmp_path, monkeypatch, error):
    def break_off(graph, path, dcn):
        path.write_bytes(b"half a graph")
        raise error

    monkeypatch.setattr(bundle, "trace", break_off)
    with pytest.raises(error):
        export_bundle(tiny_model, tmp_path / "bundle")
    assert list(tmp_path.iterdir()) == []


def test_what_stands_at_the_place_of_a_bundle_stays(tiny_model, tmp_path):
    (tmp_path / "bundle").mkdir()
    with pytest.raises(OutputError, match="expected a new folder; it exists already"):
        export_bundle(tiny_model, tmp_path / "bundle")


def with_one_weight_changed(trace):
    def changed(graph, path, dcn):
        trace(graph, path, dcn)
        if graph.name == "segmenter":
            model = onnx.load(path)
            bias = next(tensor for tensor in model.graph.initializer if tensor.name.endswith("drivable_area.3.bias"))
            bias.CopyFrom(numpy_helper.from_array(numpy_helper.to_array(bias) * 1.001 + 1e-3, bias.name))
            onnx.save(model, path)

    return changed


def hashes(folder: Path) -> dict[str, bytes]:
    return {name: (folder / name).read_bytes() for name in GRAPHS}


def _passed() -> ParityResult:
    return ParityResult(source="none", frames=0, graphs={}, stream=[], dead_inputs=[])
