"""Files that other parsers read in another way than they look. Fuzzing: tests/fuzz/test_graph_files.py."""

import numpy as np
import onnxruntime as ort
import pytest
from onnx import TensorProto, helper, numpy_helper

from duospacenet.runtime.bundle.graph_file import MAX_FILE_BYTES, check_graph
from duospacenet.runtime.bundle.manifest import GraphSpec, TensorSpec
from duospacenet.runtime.cores import available_cores
from duospacenet.runtime.errors import ArtifactError
from duospacenet.runtime.onnxruntime_session import OnnxruntimeSession, set_thread_pool_size
from tests.helpers.wire_format import BYTES, field, varint

SECRET = np.array([4.0, 2.0], np.float32)


def model(*initializers: bytes, nodes: bytes = b"", before: bytes = b"") -> bytes:
    """A model that returns the tensor `w`, from encoded parts."""
    out = helper.make_tensor_value_info("out", TensorProto.FLOAT, [2]).SerializeToString()
    node = helper.make_node("Identity", ["w"], ["out"]).SerializeToString()
    graph = field(1, node) + nodes + field(2, b"g") + b"".join(field(5, part) for part in initializers) + field(12, out)
    opset = helper.make_opsetid("", 20).SerializeToString()
    return before + field(1, 10) + field(7, graph) + field(8, opset)


PLAIN = numpy_helper.from_array(np.ones(2, np.float32), "w").SerializeToString()
HEAD = field(1, 2) + field(2, TensorProto.FLOAT) + field(8, b"w")  # dims, data_type, name


def entry(name: bytes, value: bytes) -> bytes:
    return field(1, name) + field(2, value)


def run_without_checks(content: bytes, folder) -> np.ndarray:
    """The output of the model in onnxruntime, loaded from a file in `folder`."""
    (folder / "model.onnx").write_bytes(content)
    session = ort.InferenceSession(folder / "model.onnx", session_options(), providers=["CPUExecutionProvider"])
    return session.run(None, {})[0]


def session_options() -> ort.SessionOptions:
    """Options without those that protect a `Session`."""
    set_thread_pool_size(available_cores())
    options = ort.SessionOptions()
    options.use_per_session_threads = False
    options.log_severity_level = 4
    return options


def test_a_plain_model_is_accepted(tmp_path):
    assert check_graph(model(PLAIN), tmp_path) == {"": 20}
    assert run_without_checks(model(PLAIN), tmp_path).tolist() == [1, 1]


def test_external_data_behind_a_key_of_more_than_32_bits_is_refused(tmp_path):
    """Control: onnxruntime drops the high bits and reads the other file."""
    (tmp_path / "secret").write_bytes(SECRET.tobytes())
    hidden_key = varint(13 << 3 | BYTES | 1 << 32)
    location = entry(b"location", b"secret")
    tensor = HEAD + hidden_key + varint(len(location)) + location + field(14, 1)
    shown = HEAD + field(13, location) + field(14, 1)
    content = model(tensor)
    assert run_without_checks(model(shown), tmp_path).tolist() == SECRET.tolist()
    assert run_without_checks(content, tmp_path).tolist() == SECRET.tolist()
    for data in (content, model(shown)):
        with pytest.raises(ArtifactError, match=r"the field number 536870925|a tensor with external data"):
            check_graph(data, tmp_path)


def test_an_operator_behind_a_key_of_more_than_32_bits_is_refused(tmp_path):
    """Control: onnxruntime reads the second operator, RandomNormal."""
    hidden = varint(4 << 3 | BYTES | 5 << 32) + varint(len(b"RandomNormal")) + b"RandomNormal"
    shape = helper.make_attribute("shape", [2]).SerializeToString()
    node = field(2, b"unused") + field(4, b"Relu") + hidden + field(5, shape)
    content = model(PLAIN, nodes=field(1, node))
    assert run_without_checks(content, tmp_path).tolist() == [1, 1]
    with pytest.raises(ArtifactError, match="the field number"):
        check_graph(content, tmp_path)


def test_an_operator_that_is_given_twice_is_refused(tmp_path):
    node = field(2, b"unused") + field(4, b"RandomNormal") + field(4, b"Relu")
    with pytest.raises(ArtifactError, match=r"NodeProto\.op_type twice"):
        check_graph(model(PLAIN, nodes=field(1, node)), tmp_path)


def test_a_second_graph_that_is_merged_with_the_first_is_refused(tmp_path):
    """Control: onnxruntime reads one graph with the tensor of the second part."""
    second = field(7, field(5, PLAIN))
    assert run_without_checks(model() + second, tmp_path).tolist() == [1, 1]
    with pytest.raises(ArtifactError, match=r"ModelProto\.graph twice"):
        check_graph(model() + second, tmp_path)


@pytest.mark.parametrize("location", [1, 2, 2**31, 2**32 + 1, 2**64 - 1])
def test_any_data_location_but_the_file_itself_is_refused(tmp_path, location):
    with pytest.raises(ArtifactError, match="a tensor with external data"):
        check_graph(model(PLAIN + field(14, location)), tmp_path)
    assert check_graph(model(PLAIN + field(14, 0)), tmp_path) == {"": 20}


def test_the_mark_of_ort_format_is_refused(tmp_path):
    """Control: onnxruntime takes the bytes for a model in ORT format, whatever the name of the file is."""
    content = model(PLAIN, before=field(2, b"..ORTM.."))
    assert content[4:8] == b"ORTM"
    options = session_options()
    with pytest.raises(Exception, match="ORT model verification failed"):
        ort.InferenceSession(content, options, providers=["CPUExecutionProvider"], enable_fallback=0)
    with pytest.raises(ArtifactError, match="expected an ONNX file; got the mark of a model in ORT format"):
        check_graph(content, tmp_path)


def test_a_session_reads_every_file_as_onnx(tmp_path):
    set_thread_pool_size(available_cores())
    outputs = (TensorSpec(name="out", shape=(2,), dtype="float32"),)
    spec = GraphSpec(file="a.onnx", sha256="", inputs=(), outputs=outputs)
    session = OnnxruntimeSession(model(PLAIN, before=field(2, b"..ORTM..")), spec, tmp_path / "a.onnx")
    assert session.run({})["out"].numpy().tolist() == [1, 1]


@pytest.mark.parametrize(
    "part",
    [
        field(5, helper.make_attribute("x", 1).SerializeToString() + field(21, b"ref")),
        field(8, b"overload"),
        field(9, entry(b"key", b"value")),
        field(10, field(1, b"configuration")),
        field(6, b"text"),
    ],
    ids=["ref_attr_name", "overload", "metadata", "device configuration", "doc string"],
)
def test_fields_of_nodes_that_are_not_exported_are_refused(tmp_path, part):
    node = field(1, b"w") + field(2, b"unused") + field(4, b"Relu")
    assert check_graph(model(PLAIN, nodes=field(1, node)), tmp_path)
    with pytest.raises(ArtifactError, match="which no exported graph has"):
        check_graph(model(PLAIN, nodes=field(1, node + part)), tmp_path)


def test_an_empty_file_and_a_file_without_operator_set_are_refused(tmp_path):
    with pytest.raises(ArtifactError, match=f"expected an ONNX file of 1 to {MAX_FILE_BYTES} bytes; got 0"):
        check_graph(b"", tmp_path)
    with pytest.raises(ArtifactError, match=r"expected one operator set of version 19 to 22; got \[\]"):
        check_graph(field(1, 10), tmp_path)
