"""Reliability rows A3, A6 to A9 and A12: damaged, mixed and malicious bundles. A10 is in test_parity_faults.py."""

import json
import os
import re
import shutil
from pathlib import Path

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper, numpy_helper

from duospacenet.cli.main import run_app
from duospacenet.runtime import Pipeline
from duospacenet.runtime.bundle import protobuf
from duospacenet.runtime.bundle.bundle_files import check_files
from duospacenet.runtime.bundle.graph_file import MAX_FIELDS, MAX_NODES
from duospacenet.runtime.bundle.manifest import read_manifest
from duospacenet.runtime.bundle.schema_versions import SCHEMA_VERSION
from duospacenet.runtime.errors import ArtifactError
from tests.helpers.bundles import (
    GRAPHS,
    check_file,
    edit_graph,
    edit_manifest,
    update_graph_hash,
    write_sealed_manifest,
)
from tests.helpers.golden_manifest import SCHEMA_1, SCHEMA_2, SCHEMA_3, SCHEMA_4, SCHEMA_5
from tests.helpers.older_schemas import downgrade
from tests.helpers.wire_format import BYTES, field, varint


@pytest.fixture
def forbid_onnxruntime(monkeypatch):
    """Fails the test if onnxruntime opens a file."""

    def fail(*_arguments, **_options):
        pytest.fail("onnxruntime opened a file")

    monkeypatch.setattr("duospacenet.runtime.onnxruntime_session.ort.InferenceSession", fail)


# --- A3: a flipped bit ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("file", ["manifest.json", *(f"{graph}.onnx" for graph in GRAPHS)])
def test_a3_a_flipped_bit_is_detected_at_any_position(copied_bundle, file):
    path = copied_bundle / file
    whole = path.read_bytes()
    rng = np.random.default_rng(0)
    for offset in [*rng.integers(0, len(whole), 100), len(whole) - 1]:
        damaged = bytearray(whole)
        damaged[offset] ^= 1 << rng.integers(8)
        path.write_bytes(damaged)
        with pytest.raises(ArtifactError, match=file.replace(".", r"\.")):
            check_files(copied_bundle, read_manifest(copied_bundle))
    path.write_bytes(whole)
    check_files(copied_bundle, read_manifest(copied_bundle))


def test_a3_a_flipped_bit_in_the_last_90_bytes_of_the_manifest_is_detected(copied_bundle):
    path = copied_bundle / "manifest.json"
    whole = path.read_bytes()
    for offset in range(len(whole) - 90, len(whole)):
        for bit in range(8):
            damaged = bytearray(whole)
            damaged[offset] ^= 1 << bit
            path.write_bytes(damaged)
            with pytest.raises(ArtifactError, match=r"manifest\.json"):
                check_files(copied_bundle, read_manifest(copied_bundle))


def test_a3_an_edited_manifest_is_refused_because_of_its_seal(copied_bundle):
    path = copied_bundle / "manifest.json"
    path.write_text(path.read_text().replace('"largest_speed_m_s": 70.0', '"largest_speed_m_s": 90.0'))
    with pytest.raises(ArtifactError, match=r"manifest\.json: field sha256: expected .* was edited"):
        Pipeline.load(copied_bundle)


def test_a3_a_manifest_of_schema_2_without_a_seal_is_refused(copied_bundle):
    manifest = json.loads((copied_bundle / "manifest.json").read_text())
    del manifest["sha256"]
    (copied_bundle / "manifest.json").write_text(json.dumps(manifest))
    with pytest.raises(ArtifactError, match=r"field sha256: expected .*; got none"):
        Pipeline.load(copied_bundle)


# --- A6: graphs of two bundles mixed ----------------------------------------------------------------------------


@pytest.mark.parametrize("graph", GRAPHS)
def test_a6_a_graph_of_another_bundle_with_the_same_shapes_is_refused(copied_bundle, forbid_onnxruntime, graph):
    path = copied_bundle / f"{graph}.onnx"
    model = onnx.load(path)
    kinds = (TensorProto.FLOAT, TensorProto.DOUBLE)  # the projector's numbers are double
    numbers = [tensor for tensor in model.graph.initializer if tensor.data_type in kinds]
    weights = max(numbers, key=lambda tensor: len(tensor.raw_data))
    weights.CopyFrom(numpy_helper.from_array(numpy_helper.to_array(weights) * np.float32(1.5), weights.name))
    onnx.save(model, path)
    with pytest.raises(ArtifactError, match=rf"{graph}\.onnx: .* damaged or belongs to another bundle"):
        Pipeline.load(copied_bundle)


# --- A7: external data -------------------------------------------------------------------------------------------


def plain_tensor():
    return numpy_helper.from_array(np.ones(1, np.float32), "weights")


def external_tensor(location):
    """A tensor whose data are in another file."""
    tensor = plain_tensor()
    tensor.ClearField("raw_data")
    tensor.data_location = TensorProto.EXTERNAL
    for key, value in {"location": location, "offset": "0", "length": "4"}.items():
        tensor.external_data.add(key=key, value=value)
    return tensor


def in_an_initializer(model, tensor):
    model.graph.initializer.append(tensor)


def in_an_attribute(model, tensor):
    model.graph.node[0].attribute.append(helper.make_attribute("value", tensor))


def in_a_constant(model, tensor):
    node = helper.make_node("Constant", [], ["constant"])
    node.attribute.append(helper.make_attribute("value", tensor))
    model.graph.node.insert(0, node)


def branch(*tensors):
    output = [helper.make_tensor_value_info("out", TensorProto.FLOAT, [1])]
    return helper.make_graph([helper.make_node("Identity", ["weights"], ["out"])], "branch", [], output, tensors)


def in_a_subgraph(model, tensor):
    """In a branch of an If inside a branch of another If."""
    inner = branch(tensor)
    for name in ("branch", "outer"):
        node = helper.make_node("If", ["condition"], ["out"], then_branch=inner, else_branch=inner)
        inner = helper.make_graph([node], name, [], inner.output)
    model.graph.node.append(helper.make_node("If", ["condition"], ["unused"], then_branch=inner, else_branch=inner))


def in_a_subgraph_of_a_plain_operator(model, tensor):
    model.graph.node[0].attribute.append(helper.make_attribute("body", branch(tensor)))


def sparse(tensor):
    indices = numpy_helper.from_array(np.zeros(1, np.int64), "indices")
    return onnx.SparseTensorProto(values=tensor, indices=indices, dims=[1])


def in_a_sparse_initializer(model, tensor):
    model.graph.sparse_initializer.append(sparse(tensor))


def in_a_list_of_sparse_attributes(model, tensor):
    attribute = model.graph.node[0].attribute.add(name="values", type=onnx.AttributeProto.SPARSE_TENSORS)
    attribute.sparse_tensors.extend([sparse(plain_tensor()), sparse(tensor)])


def in_a_list_of_attributes(model, tensor):
    attribute = model.graph.node[0].attribute.add(name="values", type=onnx.AttributeProto.TENSORS)
    attribute.tensors.extend([plain_tensor(), tensor])


def without_data_location(model, tensor):
    """With external_data entries, but data_location left at its default."""
    tensor.ClearField("data_location")
    model.graph.initializer.append(tensor)


EXTERNAL = "expected every tensor in the file itself; got a tensor with external data"
PLACES = {
    in_an_initializer: EXTERNAL,
    without_data_location: EXTERNAL,
    in_an_attribute: "expected numbers and text as attributes; got a tensor at operator",
    in_a_list_of_attributes: "expected numbers and text as attributes; got a tensor at operator",
    in_a_list_of_sparse_attributes: "expected numbers and text as attributes; got a sparse tensor at operator",
    in_a_subgraph_of_a_plain_operator: "expected numbers and text as attributes; got a subgraph at operator",
    in_a_constant: "expected only the operators that duospacenet exports; got 'Constant'",
    in_a_subgraph: "expected only the operators that duospacenet exports; got 'If'",
    in_a_sparse_initializer: "expected dense tensors; got a sparse initializer",
}


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("kind", ["a file beside it", "parent folder", "absolute path", "symbolic link", "hard link"])
def test_a7_external_data_is_refused_before_onnxruntime_opens_the_file(copied_bundle, forbid_onnxruntime, place, kind):
    secret = copied_bundle.parent / "secret"
    secret.write_bytes(np.ones(1, np.float32).tobytes())
    location = {"parent folder": "../secret", "absolute path": str(secret)}.get(kind, "data.bin")
    data = copied_bundle / "data.bin"
    if kind == "a file beside it":
        shutil.copy(secret, data)
    elif kind == "symbolic link":
        data.symlink_to(secret)
    elif kind == "hard link":
        os.link(secret, data)
    edit_graph(copied_bundle, "lifter", lambda model: place(model, external_tensor(location)))
    with pytest.raises(ArtifactError, match=rf"lifter\.onnx: {PLACES[place]}"):
        Pipeline.load(copied_bundle)


@pytest.mark.parametrize("place", [in_an_initializer, without_data_location])
def test_a7_the_same_tensor_with_its_data_in_the_file_is_accepted(copied_bundle, place):
    """Control: the test above must not fail for another reason than the external data."""
    edit_graph(copied_bundle, "lifter", lambda model: place(model, plain_tensor()))
    assert check_file(copied_bundle / "lifter.onnx") == {"": 19}


# --- A8: custom operators and excessive sizes ---------------------------------------------------------------------


def in_a_node(model):
    model.graph.node[0].domain = "com.example"


def in_the_list_of_domains(model):
    model.opset_import.append(helper.make_opsetid("com.example", 1))


def in_a_function(model):
    function = model.functions.add()
    function.name, function.domain = "Relu", "com.example"


def in_training_info(model):
    model.training_info.add()


def in_a_subgraphs_node(model):
    output = [helper.make_tensor_value_info("out", TensorProto.FLOAT, [1])]
    branch = helper.make_graph([helper.make_node("Evil", [], ["out"], domain="com.example")], "branch", [], output)
    model.graph.node.append(helper.make_node("If", ["c"], ["out"], then_branch=branch, else_branch=branch))


@pytest.mark.parametrize(
    ("place", "message"),
    [
        (in_a_node, "domain 'com.example'"),
        (in_the_list_of_domains, "domain 'com.example'"),
        (in_a_subgraphs_node, "operators that duospacenet exports; got 'If'"),
        (in_a_function, "plain operators only; got functions"),
        (in_training_info, "plain operators only; got training graphs"),
    ],
)
def test_a8_operators_that_are_not_from_onnx_are_refused(copied_bundle, forbid_onnxruntime, place, message):
    edit_graph(copied_bundle, "decoder", place)
    with pytest.raises(ArtifactError, match=rf"decoder\.onnx: .*{message}"):
        Pipeline.load(copied_bundle)


@pytest.mark.parametrize(
    "operator",
    [
        "Loop",
        "If",
        "Scan",
        "SequenceMap",
        "RandomNormal",
        "RandomUniformLike",
        "Multinomial",
        "Bernoulli",
        "Relu\x1b[2J",
    ],
)
def test_a8_operators_that_are_not_exported_are_refused_by_name(copied_bundle, forbid_onnxruntime, operator):
    edit_graph(copied_bundle, "decoder", lambda model: setattr(model.graph.node[3], "op_type", operator))
    with pytest.raises(ArtifactError) as error:
        Pipeline.load(copied_bundle)
    assert f"decoder.onnx: expected only the operators that duospacenet exports; got {operator!r}" in str(error.value)


LOOP_INPUTS = {"index": TensorProto.INT64, "go": TensorProto.BOOL}


def test_a8_an_endless_loop_is_refused_and_named(copied_bundle, forbid_onnxruntime):
    """A loop that would run for hundreds of years, with all of its parts valid."""
    body = helper.make_graph(
        [helper.make_node("Identity", ["go"], ["go_on"])],
        "body",
        [helper.make_tensor_value_info(name, kind, []) for name, kind in LOOP_INPUTS.items()],
        [helper.make_tensor_value_info("go_on", TensorProto.BOOL, [])],
    )

    def add_loop(model):
        model.graph.initializer.append(numpy_helper.from_array(np.array(2**62), "times"))
        model.graph.initializer.append(numpy_helper.from_array(np.array(True), "always"))
        model.graph.node.append(helper.make_node("Loop", ["times", "always"], [], body=body))

    edit_graph(copied_bundle, "decoder", add_loop)
    with pytest.raises(ArtifactError, match=r"decoder\.onnx: expected only the operators .* got 'Loop'"):
        Pipeline.load(copied_bundle)


def test_a8_operator_sets_in_the_manifest_are_compared_with_the_file(copied_bundle, forbid_onnxruntime):
    manifest = json.loads((copied_bundle / "manifest.json").read_text())
    assert [graph["opsets"] for graph in manifest["graphs"].values()] == [{"": 19}] * len(GRAPHS)
    edit_manifest(copied_bundle, lambda manifest: manifest["graphs"]["decoder"].update(opsets={"": 17}))
    with pytest.raises(ArtifactError, match=r"decoder\.onnx: opsets: .* says \{'': 17\}; it has \{'': 19\}"):
        Pipeline.load(copied_bundle)


@pytest.mark.parametrize(
    ("imports", "got"),
    [
        ([("", 17)], r"\[17\]"),
        ([("", 18)], r"\[18\]"),
        ([("", 23)], r"\[23\]"),
        ([("", 19), ("", 17)], r"\[19, 17\]"),
        ([("", 19), ("ai.onnx", 19)], ""),
        ([], r"\[\]"),
    ],
)
def test_a8_another_operator_set_is_refused(copied_bundle, forbid_onnxruntime, imports, got):
    def change(model):
        del model.opset_import[:]
        model.opset_import.extend(helper.make_opsetid(*entry) for entry in imports)

    edit_graph(copied_bundle, "decoder", change)
    with pytest.raises(
        ArtifactError, match=rf"decoder\.onnx: expected one operator set of version 19 to 22; got {got}"
    ):
        Pipeline.load(copied_bundle)


def test_a8_a_million_nodes_are_refused_after_a_limited_number_of_fields(
    copied_bundle, forbid_onnxruntime, monkeypatch
):
    node = helper.make_node("Relu", ["x"], ["y"]).SerializeToString()
    (copied_bundle / "lifter.onnx").write_bytes(field(7, field(1, node) * 1_000_000))
    update_graph_hash(copied_bundle, "lifter")
    num_fields, raw_fields = 0, protobuf._raw_fields

    def counting(content):
        nonlocal num_fields
        for value in raw_fields(content):
            num_fields += 1
            yield value

    monkeypatch.setattr(protobuf, "_raw_fields", counting)
    with pytest.raises(ArtifactError, match=r"lifter\.onnx: expected an ONNX file .* got too many fields"):
        Pipeline.load(copied_bundle)
    assert MAX_FIELDS < num_fields < MAX_FIELDS + 50_000  # those of the other graphs


def test_a8_more_than_50000_nodes_are_refused(copied_bundle, forbid_onnxruntime):
    node = helper.make_node("Relu", ["x"], ["y"]).SerializeToString()
    opset = helper.make_opsetid("", 20).SerializeToString()
    (copied_bundle / "lifter.onnx").write_bytes(field(7, field(1, node) * 50_001) + field(8, opset))
    update_graph_hash(copied_bundle, "lifter")
    with pytest.raises(ArtifactError, match=r"lifter\.onnx: expected at most 50000 nodes; got 50001"):
        Pipeline.load(copied_bundle)


@pytest.mark.parametrize("kind", ["too large", "FIFO", "folder", "device"])
@pytest.mark.parametrize("name", ["lifter.onnx", "manifest.json"])
def test_a8_a_special_file_is_refused_without_opening_it(copied_bundle, forbid_onnxruntime, monkeypatch, name, kind):
    path = copied_bundle / name
    path.unlink()
    if kind == "too large":
        with path.open("wb") as file:
            file.truncate(60 * 10**9)  # a sparse file, which needs no disk space
    elif kind == "FIFO":
        os.mkfifo(path)
    elif kind == "folder":
        path.mkdir()
    else:
        path.symlink_to("/dev/zero")
    opened, open_file = [], os.open
    monkeypatch.setattr(os, "open", lambda path, *options: opened.append(Path(path).name) or open_file(path, *options))
    with pytest.raises(ArtifactError, match=rf"{name}: expected a (regular file; got a |file of at most \d+ bytes)"):
        Pipeline.load(copied_bundle)
    assert opened == ([] if name == "manifest.json" else ["manifest.json", "projector.onnx", "backbone.onnx"])


def test_a8_recursive_graphs_are_not_followed(tmp_path):
    """A chain of graph, node, attribute, graph, ... by the field numbers 1, 5 and 6."""
    message = b""
    for number in [6, 5, 1] * 1000:
        message = field(number, message)
    (tmp_path / "deep.onnx").write_bytes(field(7, message) + field(8, helper.make_opsetid("", 20).SerializeToString()))
    with pytest.raises(ArtifactError, match="expected only the operators"):
        check_file(tmp_path / "deep.onnx")


def test_a8_the_tiny_decoder_has_less_than_a_tenth_of_the_allowed_nodes(tiny_bundle):
    nodes = len(onnx.load(tiny_bundle / "decoder.onnx").graph.node)
    assert nodes * 10 < MAX_NODES


# --- A9: newer and older schemas ---------------------------------------------------------------------------------

EACH_SCHEMA = [SCHEMA_1, SCHEMA_2, SCHEMA_3, SCHEMA_4, SCHEMA_5]


@pytest.mark.parametrize("golden", EACH_SCHEMA, ids=lambda golden: f"schema {golden['schema_version']}")
def test_a9_a_manifest_of_each_schema_is_read_field_by_field(tmp_path, golden):
    if golden is SCHEMA_1:
        (tmp_path / "manifest.json").write_text(json.dumps(golden))
    else:
        write_sealed_manifest(tmp_path, golden)
    manifest = read_manifest(tmp_path)
    assert manifest.classes == ("car", "pedestrian")
    assert (manifest.num_cameras, manifest.window.num_frames) == (6, 4)
    assert (manifest.preprocessing.width_px, manifest.preprocessing.height_px) == (160, 64)
    assert (manifest.window.largest_time_delta_s, manifest.window.largest_speed_m_s) == (2.0, 70.0)
    assert manifest.perception.lower_m == (-51.2, -51.2, -3.0)
    assert manifest.graphs["lifter"].file == "lifter.onnx"
    assert manifest.graphs["lifter"].inputs[0].shape == (6, 64, 160, 3)
    assert manifest.weights.trained is False
    assert manifest.graphs["lifter"].opsets == ({} if golden is SCHEMA_1 else {"": 20})
    assert (manifest.weights.checkpoint is None) == (golden is SCHEMA_1)
    assert (manifest.parity.coverage is None) == (golden in (SCHEMA_1, SCHEMA_2))


def test_a9_a_bundle_of_schema_1_still_runs(copied_bundle):
    manifest = json.loads((copied_bundle / "manifest.json").read_text())
    downgrade(manifest, 1)
    assert set(manifest) == set(SCHEMA_1)
    (copied_bundle / "manifest.json").write_text(json.dumps(manifest))
    assert Pipeline.load(copied_bundle).manifest.schema_version == 1


def test_a9_a_newer_schema_is_refused_with_the_advice_to_update(copied_bundle, capfd):
    manifest = json.loads((copied_bundle / "manifest.json").read_text())
    write_sealed_manifest(copied_bundle, manifest | {"schema_version": SCHEMA_VERSION + 1, "of_the_future": True})
    assert run_app(["inspect", str(copied_bundle)]) == 4
    message = capfd.readouterr().err
    assert f"field schema_version: expected at most {SCHEMA_VERSION}; got {SCHEMA_VERSION + 1}" in message
    assert "update the toolkit" in message


# --- A12: files that the checks and onnxruntime could read in different ways -----------------------------------------


def hide_a_tensor_in_another_file(bundle):
    """The key of `external_data` has a bit above the 32nd, which onnxruntime drops."""
    entry = field(1, b"location") + field(2, b"secret")
    hidden = varint(13 << 3 | BYTES | 1 << 32) + varint(len(entry)) + entry
    tensor = field(1, 1) + field(2, TensorProto.FLOAT) + field(8, b"weights") + hidden + field(14, 1)
    path = bundle / "lifter.onnx"
    model = onnx.load(path)
    graph = model.graph.SerializeToString()
    model.ClearField("graph")
    path.write_bytes(model.SerializeToString() + field(7, graph + field(5, tensor)))
    update_graph_hash(bundle, "lifter")


def add_a_second_graph(bundle):
    """Protobuf libraries merge both graphs."""
    (bundle / "lifter.onnx").write_bytes((bundle / "lifter.onnx").read_bytes() + field(7, field(5, b"")))
    update_graph_hash(bundle, "lifter")


def use_ort_format(bundle):
    """onnxruntime reads a file of this name as a flatbuffer."""
    (bundle / "lifter.onnx").rename(bundle / "lifter.ort")
    edit_manifest(bundle, lambda manifest: manifest["graphs"]["lifter"].update(file="lifter.ort"))


def mark_as_ort_format(bundle):
    """onnxruntime takes such bytes for a flatbuffer, whatever the name of the file is."""
    edit_graph(bundle, "lifter", lambda model: setattr(model, "producer_name", "..ORTM.."))
    path = bundle / "lifter.onnx"
    name = field(2, b"..ORTM..")
    path.write_bytes(name + path.read_bytes().replace(name, b"", 1))
    assert path.read_bytes()[4:8] == b"ORTM"
    update_graph_hash(bundle, "lifter")


def call_it_schema_1(bundle):
    """Schema 1 has no seal. The edit would otherwise be noticed."""
    path = bundle / "manifest.json"
    text = path.read_text().replace(f'"schema_version": {SCHEMA_VERSION}', '"schema_version": 1', 1)
    path.write_text(text.replace('"largest_speed_m_s": 70.0', '"largest_speed_m_s": 7.0', 1))


AMBIGUOUS = {
    hide_a_tensor_in_another_file: r"lifter\.onnx: .* got the field number 536870925",
    add_a_second_graph: r"lifter\.onnx: .* got ModelProto\.graph twice",
    use_ort_format: r"manifest\.json: field graphs\.lifter\.file: expected 'lifter\.onnx'; got 'lifter\.ort'",
    mark_as_ort_format: r"lifter\.onnx: expected an ONNX file; got the mark of a model in ORT format",
    call_it_schema_1: r"manifest\.json: field (sha256|dcn): expected only since schema 2",
}


@pytest.mark.parametrize("edit", AMBIGUOUS)
def test_a12_a_file_that_could_be_read_in_two_ways_is_refused(copied_bundle, forbid_onnxruntime, capfd, edit):
    edit(copied_bundle)
    with pytest.raises(ArtifactError, match=AMBIGUOUS[edit]):
        Pipeline.load(copied_bundle)
    assert run_app(["inspect", str(copied_bundle)]) == 4
    out, err = capfd.readouterr()
    assert out == ""
    assert re.search(AMBIGUOUS[edit], err)


def test_a12_a_file_that_is_exchanged_after_its_check_is_not_read(copied_bundle, monkeypatch):
    """onnxruntime gets the bytes that were checked. Control: the exchanged bytes would not be a graph."""

    def exchange_files(_threads):
        for path in copied_bundle.glob("*.onnx"):
            path.write_bytes(b"exchanged")

    monkeypatch.setattr("duospacenet.runtime.engine.set_thread_pool_size", exchange_files)
    assert len(Pipeline.load(copied_bundle).sessions) == len(GRAPHS)
    with pytest.raises(ArtifactError, match=r"\.onnx: field graphs\.\w+\.sha256"):
        Pipeline.load(copied_bundle)
