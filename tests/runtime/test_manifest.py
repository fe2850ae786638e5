import json
import shutil

import numpy as np
import onnx
import pytest
from onnx import numpy_helper

from duospacenet.runtime import Pipeline
from duospacenet.runtime.errors import ArtifactError
from duospacenet.runtime.manifest import check_graph_files, read_manifest, sha256

GRAPHS = ("projector", "backbone", "lifter", "decoder", "segmenter")

# A manifest of schema 1, as a consumer may rely on it. It must stay readable for as long as schema 1 is.
GOLDEN = {
    "schema_version": 1,
    "versions": {"duospacenet": "0.1.0", "torch": "2.13.0", "onnx": "1.20.0", "onnxscript": "0.7.0"},
    "preset": "tiny",
    "config": {"preset": "tiny", "num_queries": 32},
    "classes": ["car", "pedestrian"],
    "map_classes": ["drivable_area"],
    "num_cameras": 6,
    "preprocessing": {
        "width_px": 160,
        "height_px": 64,
        "colour_order": "bgr",
        "resize_shrinking": "area",
        "resize_enlarging": "linear",
        "crop": "centre columns, bottom rows",
        "normalisation_in_graph": {"colour_order": "rgb", "mean": [123.675, 116.28, 103.53], "std": [58.4, 57.1, 57.4]},
    },
    "window": {
        "num_frames": 4,
        "nominal_time_delta_s": 0.5,
        "largest_time_delta_s": 2.0,
        "largest_speed_m_s": 70.0,
    },
    "perception": {"size": [16, 16, 4], "lower_m": [-51.2, -51.2, -3.0], "upper_m": [51.2, 51.2, 5.0]},
    "frames_of_reference": {"ego": "x forward, y left, z up"},
    "tensors": {"class_logits": "a score is 1 / (1 + exp(-logit))"},
    "memory": ["bev_value_0"],
    "precision": "float32",
    "weights": {"source": "random, seed 0", "sha256": "0" * 64, "file_sha256": None, "trained": False},
    "graphs": {
        name: {
            "file": f"{name}.onnx",
            "sha256": "0" * 64,
            "inputs": [{"name": "images", "shape": [6, 64, 160, 3], "dtype": "uint8"}],
            "outputs": [{"name": "bev", "shape": [1, 32, 16, 16], "dtype": "float32"}],
        }
        for name in GRAPHS
    },
    "parity": {
        "passed": True,
        "failures": [],
        "tolerances": {"graph": 1e-4, "box": 1e-3, "score": 1e-3},
        "source": "scripted drive",
        "frames": 1,
        "graphs": {"decoder": {"boxes": {"absolute": 1e-6, "relative": 1e-7, "cosine": 1.0, "frame": 0}}},
        "stream": [
            {"window": 1, "boxes": 3, "unmatched": 0, "box": 1e-6, "score": 1e-7, "map": None, "history": 0},
        ],
        "dead_inputs": [],
    },
}


def write_manifest(folder, manifest):
    (folder / "manifest.json").write_text(manifest if isinstance(manifest, str) else json.dumps(manifest))
    return folder


def edit_manifest(bundle, change):
    """Change the JSON of a bundle's manifest."""
    manifest = json.loads((bundle / "manifest.json").read_text())
    change(manifest)
    return write_manifest(bundle, manifest)


@pytest.fixture
def copied_bundle(tiny_bundle, tmp_path):
    return shutil.copytree(tiny_bundle, tmp_path / "bundle")


def test_a_manifest_of_schema_1_is_read_field_by_field(tmp_path):
    manifest = read_manifest(write_manifest(tmp_path, GOLDEN))
    assert manifest.classes == ("car", "pedestrian")
    assert (manifest.num_cameras, manifest.window.num_frames) == (6, 4)
    assert (manifest.preprocessing.width_px, manifest.preprocessing.height_px) == (160, 64)
    assert (manifest.window.largest_time_delta_s, manifest.window.largest_speed_m_s) == (2.0, 70.0)
    assert manifest.perception.lower_m == (-51.2, -51.2, -3.0)
    assert manifest.graphs["lifter"].file == "lifter.onnx"
    assert manifest.graphs["lifter"].inputs[0].shape == (6, 64, 160, 3)
    assert manifest.weights.trained is False


def test_a_manifest_without_a_parity_report_is_read(tmp_path):
    manifest = {name: value for name, value in GOLDEN.items() if name != "parity"}
    assert read_manifest(write_manifest(tmp_path, manifest)).parity is None


def test_what_is_exported_is_what_is_read(tiny_bundle):
    manifest = json.loads((tiny_bundle / "manifest.json").read_text())
    assert set(manifest) == set(GOLDEN)
    assert json.loads(read_manifest(tiny_bundle).model_dump_json()) == manifest
    assert manifest["parity"]["passed"] is True


# Damaged fields


def at(*path, value):
    """A change that puts a value where the path leads."""

    def change(manifest):
        *way, last = path
        for step in way:
            manifest = manifest[step]
        manifest[last] = value

    return change


def without(*path):
    def change(manifest):
        *way, last = path
        for step in way:
            manifest = manifest[step]
        del manifest[last]

    return change


DAMAGE = {
    "a newer schema": (
        at("schema_version", value=2),
        "schema_version: expected at most 1; got 2. The bundle is newer than this toolkit",
    ),
    "an unknown older schema": (at("schema_version", value=0), "schema_version: Input should be 1; got 0"),
    "no schema": (without("schema_version"), "schema_version: Field required"),
    "a schema as a word": (at("schema_version", value="one"), "schema_version: Input should be a valid integer"),
    "no classes": (without("classes"), "classes: Field required"),
    "classes that are numbers": (at("classes", value=[1, 2]), "classes.0: Input should be a valid string; got 1"),
    "an unknown field": (at("hash", value="x"), "hash: Extra inputs are not permitted; got 'x'"),
    "an unknown field deep inside": (
        at("preprocessing", "padding", value=3),
        "preprocessing.padding: Extra inputs are not permitted; got 3",
    ),
    "a list for a number": (at("num_cameras", value=[6]), "num_cameras: Input should be a valid integer; got [6]"),
    "null for a number": (at("num_cameras", value=None), "num_cameras: Input should be a valid integer; got None"),
    "no cameras": (at("num_cameras", value=0), "num_cameras: Input should be greater than 0; got 0"),
    "half a frame": (at("window", "num_frames", value=1.5), "window.num_frames: Input should be a valid integer"),
    "NaN seconds": (
        at("window", "largest_time_delta_s", value=float("nan")),
        "window.largest_time_delta_s: Input should be a finite number; got nan",
    ),
    "endless seconds": (
        at("window", "largest_time_delta_s", value=float("inf")),
        "window.largest_time_delta_s: Input should be a finite number; got inf",
    ),
    "another colour order": (
        at("preprocessing", "colour_order", value="rgb"),
        "preprocessing.colour_order: Input should be 'bgr'; got 'rgb'",
    ),
    "another resize": (at("preprocessing", "resize_shrinking", value="cubic"), "preprocessing.resize_shrinking: "),
    "another precision": (at("precision", value="float16"), "precision: Input should be 'float32'; got 'float16'"),
    "a graph less": (without("graphs", "lifter"), "graphs: expected projector, backbone, lifter, decoder, segmenter"),
    "a graph more": (at("graphs", "tracker", value=GOLDEN["graphs"]["lifter"]), "graphs.tracker"),
    "a graph without its hash": (without("graphs", "decoder", "sha256"), "graphs.decoder.sha256: Field required"),
    "a tensor of unknown type": (
        at("graphs", "decoder", "inputs", 0, "dtype", value="float64"),
        "graphs.decoder.inputs.0.dtype: Input should be 'float32', 'uint8' or 'bool'; got 'float64'",
    ),
    "a dimension of zero": (
        at("graphs", "backbone", "inputs", 0, "shape", 1, value=0),
        "graphs.backbone.inputs.0.shape.1: Input should be greater than 0; got 0",
    ),
    "a dimension with a name": (
        at("graphs", "backbone", "inputs", 0, "shape", 1, value="batch"),
        "graphs.backbone.inputs.0.shape.1: Input should be a valid integer",
    ),
}


@pytest.mark.parametrize("damage", DAMAGE)
def test_a_wrong_manifest_is_refused_by_file_and_field(tmp_path, damage):
    change, words = DAMAGE[damage]
    write_manifest(tmp_path, GOLDEN)
    edit_manifest(tmp_path, change)
    with pytest.raises(ArtifactError) as error:
        read_manifest(tmp_path)
    assert str(error.value).startswith(f"{tmp_path / 'manifest.json'}: field {words}")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "expected JSON; got 0 characters"),
        ("graphs: all", "expected JSON; got 11 characters"),
        (json.dumps(GOLDEN)[:-1], "expected JSON"),
        ("[1]", "field the top"),
        ("null", "field the top"),
        ("[" * 200_000, "expected JSON"),
        ('{"schema_version": ' + "1" * 5000 + "}", "expected JSON"),
    ],
)
def test_what_is_no_manifest_is_refused(tmp_path, text, words):
    with pytest.raises(ArtifactError, match=rf"manifest\.json: {words}"):
        read_manifest(write_manifest(tmp_path, text))


def test_a_manifest_that_is_not_text_is_refused(tmp_path):
    (tmp_path / "manifest.json").write_bytes(b"\x80\x02}q\x00.")
    with pytest.raises(ArtifactError, match=r"manifest\.json: cannot be read as UTF-8 text"):
        read_manifest(tmp_path)


def test_a_missing_bundle_and_a_folder_that_is_none_are_refused(tmp_path):
    with pytest.raises(ArtifactError, match="nowhere: expected a bundle folder; got no such folder"):
        read_manifest(tmp_path / "nowhere")
    with pytest.raises(ArtifactError, match=r"manifest\.json: expected a JSON file; got no such file"):
        read_manifest(tmp_path)


WORD_FOR_NUMBER = {
    "a number as a word": at("num_cameras", value="6"),
    "a number that is true": at("num_cameras", value=True),
    "seconds as a word": at("window", "largest_time_delta_s", value="2.0"),
}


@pytest.mark.parametrize("damage", WORD_FOR_NUMBER)
def test_a_word_is_no_number(tmp_path, damage):
    write_manifest(tmp_path, GOLDEN)
    with pytest.raises(ArtifactError):
        read_manifest(edit_manifest(tmp_path, WORD_FOR_NUMBER[damage]))


# Damaged graphs


@pytest.mark.parametrize("graph", GRAPHS)
def test_a_bundle_without_one_of_its_graphs_is_refused(copied_bundle, graph):
    (copied_bundle / f"{graph}.onnx").unlink()
    with pytest.raises(ArtifactError, match=rf"{graph}\.onnx: the bundle's {graph} graph is missing"):
        Pipeline.load(copied_bundle)


@pytest.mark.parametrize("graph", GRAPHS)
def test_a_single_flipped_bit_is_refused_wherever_it_is(copied_bundle, graph):
    manifest, path = read_manifest(copied_bundle), copied_bundle / f"{graph}.onnx"
    whole = path.read_bytes()
    rng = np.random.default_rng(0)
    for offset in rng.integers(0, len(whole), 20):
        damaged = bytearray(whole)
        damaged[offset] ^= 1 << rng.integers(8)
        path.write_bytes(damaged)
        with pytest.raises(ArtifactError, match=rf"{graph}\.onnx: field graphs\.{graph}\.sha256: expected .* got "):
            check_graph_files(copied_bundle, manifest)
    path.write_bytes(whole)
    check_graph_files(copied_bundle, manifest)


def test_a_truncated_graph_is_refused_before_it_is_loaded(copied_bundle):
    path = copied_bundle / "decoder.onnx"
    path.write_bytes(path.read_bytes()[:-1])
    with pytest.raises(ArtifactError, match=r"decoder\.onnx: field graphs\.decoder\.sha256"):
        Pipeline.load(copied_bundle)


@pytest.mark.parametrize("graph", GRAPHS)
def test_a_graph_of_another_bundle_with_the_same_shapes_is_refused(copied_bundle, graph):
    path = copied_bundle / f"{graph}.onnx"
    model = onnx.load(path)
    floats = [tensor for tensor in model.graph.initializer if tensor.data_type == onnx.TensorProto.FLOAT]
    weights = max(floats, key=lambda tensor: len(tensor.raw_data))
    weights.CopyFrom(numpy_helper.from_array(numpy_helper.to_array(weights) * np.float32(1.5), weights.name))
    onnx.save(model, path)
    with pytest.raises(ArtifactError, match=rf"{graph}\.onnx: .* damaged or of another bundle"):
        Pipeline.load(copied_bundle)


@pytest.mark.parametrize("file", ["../backbone.onnx", "/etc/hostname", "sub/backbone.onnx", "", ".", ".."])
def test_a_graph_file_outside_the_bundle_is_refused(copied_bundle, file):
    shutil.copy(copied_bundle / "backbone.onnx", copied_bundle.parent)
    edit_manifest(copied_bundle, at("graphs", "backbone", "file", value=file))
    with pytest.raises(ArtifactError, match=r"graphs\.backbone\.file: expected a name|graph is missing"):
        Pipeline.load(copied_bundle)


def test_the_hash_is_that_of_the_file(tmp_path):
    (tmp_path / "abc").write_bytes(b"abc")
    assert sha256(tmp_path / "abc") == "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"


# Fields that contradict each other or the graphs, which are whole

CONTRADICTIONS = {
    "a memory that no graph leaves": (at("memory", 0, value="pv_value_9_9"), "memory"),
    "fewer cameras than the graphs take": (at("num_cameras", value=5), "num_cameras"),
    "fewer frames than the decoder takes": (at("window", "num_frames", value=3), "window.num_frames"),
    "more frames than the decoder takes": (at("window", "num_frames", value=5), "window.num_frames"),
    "fewer classes than logits": (at("classes", value=["car"]), "classes"),
    "another picture than the backbone's": (at("preprocessing", "width_px", value=320), "preprocessing"),
    "other cells than the maps'": (at("perception", "size", value=[32, 16, 4]), "perception"),
    "a map class that no graph gives": (at("map_classes", value=["walkway"]), "map_classes"),
    "a gap that every frame is": (at("window", "largest_time_delta_s", value=-1.0), "window"),
    "a speed that every car exceeds": (at("window", "largest_speed_m_s", value=-1.0), "window"),
}


@pytest.mark.parametrize("contradiction", CONTRADICTIONS)
def test_a_manifest_that_contradicts_its_graphs_is_refused_before_the_first_frame(copied_bundle, contradiction):
    change, words = CONTRADICTIONS[contradiction]
    edit_manifest(copied_bundle, change)
    with pytest.raises(ArtifactError, match=rf"manifest\.json.*{words}"):
        Pipeline.load(copied_bundle)
