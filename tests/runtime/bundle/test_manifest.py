import json
import shutil

import pytest

from duospacenet.runtime import Pipeline
from duospacenet.runtime.bundle.manifest import read_manifest, sha256
from duospacenet.runtime.errors import ArtifactError
from tests.helpers.bundles import GRAPHS, edit_manifest, write_sealed_manifest
from tests.helpers.golden_manifest import SCHEMA_2


def write_manifest(folder, manifest):
    (folder / "manifest.json").write_text(manifest if isinstance(manifest, str) else json.dumps(manifest))
    return folder


@pytest.fixture
def copied_bundle(tiny_bundle, tmp_path):
    return shutil.copytree(tiny_bundle, tmp_path / "bundle")


def test_a_manifest_without_a_parity_report_is_read(tmp_path):
    manifest = {name: value for name, value in SCHEMA_2.items() if name != "parity"}
    assert read_manifest(write_sealed_manifest(tmp_path, manifest)).parity is None


def test_a_manifest_from_before_deformable_convolutions_is_read(tmp_path):
    assert "dcn" not in SCHEMA_2
    assert read_manifest(write_sealed_manifest(tmp_path, SCHEMA_2)).dcn is None


def test_what_is_exported_is_what_is_read(tiny_bundle):
    manifest = json.loads((tiny_bundle / "manifest.json").read_text())
    assert set(manifest) == {*SCHEMA_2, "dcn"}
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
        at("schema_version", value=3),
        "schema_version: expected at most 2; got 3. The bundle is newer than this toolkit",
    ),
    "an unknown older schema": (at("schema_version", value=0), "schema_version: Input should be 1 or 2; got 0"),
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
    "a graph less": (without("graphs", "lifter"), "graphs: expected lifter, beside segmenter; it is missing"),
    "a form of DCN that there is not": (at("dcn", value="plugin"), "dcn"),
    "a graph more": (at("graphs", "tracker", value=SCHEMA_2["graphs"]["lifter"]), "graphs.tracker"),
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
    write_manifest(tmp_path, SCHEMA_2)
    edit_manifest(tmp_path, change)
    with pytest.raises(ArtifactError) as error:
        read_manifest(tmp_path)
    assert str(error.value).startswith(f"{tmp_path / 'manifest.json'}: field {words}")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "expected JSON; got 0 characters"),
        ("graphs: all", "expected JSON; got 11 characters"),
        (json.dumps(SCHEMA_2)[:-1], "expected JSON"),
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
    write_manifest(tmp_path, SCHEMA_2)
    with pytest.raises(ArtifactError):
        read_manifest(edit_manifest(tmp_path, WORD_FOR_NUMBER[damage]))


# Damaged graphs


@pytest.mark.parametrize("graph", GRAPHS)
def test_a_bundle_without_one_of_its_graphs_is_refused(copied_bundle, graph):
    (copied_bundle / f"{graph}.onnx").unlink()
    with pytest.raises(ArtifactError, match=rf"{graph}\.onnx: the bundle's {graph} graph is missing"):
        Pipeline.load(copied_bundle)


def test_a_truncated_graph_is_refused_before_it_is_loaded(copied_bundle):
    path = copied_bundle / "decoder.onnx"
    path.write_bytes(path.read_bytes()[:-1])
    with pytest.raises(ArtifactError, match=r"decoder\.onnx: field graphs\.decoder\.sha256"):
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
