import json
import shutil
import tempfile
import tracemalloc
from pathlib import Path

import pytest

from duospacenet.jobs.inspection import inspect_bundle
from duospacenet.runtime import Pipeline
from duospacenet.runtime.bundle.manifest import read_manifest, sha256
from duospacenet.runtime.bundle.schema_versions import SCHEMA_VERSION
from duospacenet.runtime.errors import ArtifactError
from tests.helpers.bundles import GRAPHS, edit_manifest, write_sealed_manifest
from tests.helpers.golden_manifest import SCHEMA_2, SCHEMA_4, SCHEMA_5
from tests.helpers.json_edits import delete_at, set_at


def write_manifest(folder, manifest):
    """Write a manifest without a seal: JSON values, or any text."""
    (folder / "manifest.json").write_text(manifest if isinstance(manifest, str) else json.dumps(manifest))
    return folder


def test_a_manifest_without_a_parity_report_is_read(tmp_path):
    manifest = {name: value for name, value in SCHEMA_2.items() if name != "parity"}
    assert read_manifest(write_sealed_manifest(tmp_path, manifest)).parity is None


def test_a_manifest_from_before_deformable_convolutions_is_read(tmp_path):
    assert "dcn" not in SCHEMA_2
    assert read_manifest(write_sealed_manifest(tmp_path, SCHEMA_2)).dcn is None


def test_an_exported_manifest_is_read_back_unchanged(tiny_bundle):
    manifest = json.loads((tiny_bundle / "manifest.json").read_text())
    assert set(manifest) == set(SCHEMA_5)
    assert json.loads(read_manifest(tiny_bundle).model_dump_json()) == manifest
    assert manifest["parity"]["passed"] is True


# --- Wrong fields -------------------------------------------------------------------------------------------------


WRONG_FIELDS = {
    "a schema version as a boolean": (
        set_at("schema_version", value=True),
        "schema_version: Input should be a valid integer; got True",
    ),
    "a schema version as a decimal number": (
        set_at("schema_version", value=1.0),
        "schema_version: Input should be a valid integer; got 1.0",
    ),
    "the digits of a schema version": (
        set_at("schema_version", value="1"),
        "schema_version: Input should be a valid integer; got '1'",
    ),
    "a negative schema version": (set_at("schema_version", value=-1), "schema_version: Input should be 1, 2, 3, 4 or"),
    "a newer schema": (
        set_at("schema_version", value=6),
        "schema_version: expected at most 5; got 6. The bundle is newer than this toolkit",
    ),
    "an unknown older schema": (
        set_at("schema_version", value=0),
        "schema_version: Input should be 1, 2, 3, 4 or 5; got 0",
    ),
    "no schema version": (delete_at("schema_version"), "schema_version: Field required"),
    "a schema version as text": (
        set_at("schema_version", value="one"),
        "schema_version: Input should be a valid integer",
    ),
    "no classes": (delete_at("classes"), "classes: Field required"),
    "classes that are numbers": (set_at("classes", value=[1, 2]), "classes.0: Input should be a valid string; got 1"),
    "an unknown field": (set_at("hash", value="x"), "hash: Extra inputs are not permitted; got 'x'"),
    "an unknown nested field": (
        set_at("preprocessing", "padding", value=3),
        "preprocessing.padding: Extra inputs are not permitted; got 3",
    ),
    "a list for a number": (set_at("num_cameras", value=[6]), "num_cameras: Input should be a valid integer; got [6]"),
    "null for a number": (set_at("num_cameras", value=None), "num_cameras: Input should be a valid integer; got None"),
    "no cameras": (set_at("num_cameras", value=0), "num_cameras: Input should be greater than 0; got 0"),
    "a fractional number of frames": (
        set_at("window", "num_frames", value=1.5),
        "window.num_frames: Input should be a valid integer",
    ),
    "NaN seconds": (
        set_at("window", "largest_time_delta_s", value=float("nan")),
        "window.largest_time_delta_s: expected a finite number in the range of float64; got nan",
    ),
    "infinite seconds": (
        set_at("window", "largest_time_delta_s", value=float("inf")),
        "window.largest_time_delta_s: expected a finite number in the range of float64; got inf",
    ),
    "another colour order": (
        set_at("preprocessing", "colour_order", value="rgb"),
        "preprocessing.colour_order: Input should be 'bgr'; got 'rgb'",
    ),
    "another resize": (set_at("preprocessing", "resize_shrinking", value="cubic"), "preprocessing.resize_shrinking: "),
    "another precision": (
        set_at("precision", value="float16"),
        "precision: Input should be 'float32' or 'int8'; got 'float16'",
    ),
    "a missing graph": (delete_at("graphs", "lifter"), "graphs: expected lifter, needed by segmenter; it is missing"),
    "an unknown form of the deformable convolutions": (set_at("dcn", value="plugin"), "dcn"),
    "an unknown graph": (set_at("graphs", "tracker", value=SCHEMA_2["graphs"]["lifter"]), "graphs.tracker"),
    "a graph without its hash": (delete_at("graphs", "decoder", "sha256"), "graphs.decoder.sha256: Field required"),
    "a tensor of unknown type": (
        set_at("graphs", "decoder", "inputs", 0, "dtype", value="float64"),
        "graphs.decoder.inputs.0.dtype: Input should be 'float32', 'uint8' or 'bool'; got 'float64'",
    ),
    "a dimension of zero": (
        set_at("graphs", "backbone", "inputs", 0, "shape", 1, value=0),
        "graphs.backbone.inputs.0.shape.1: Input should be greater than 0; got 0",
    ),
    "a named dimension": (
        set_at("graphs", "backbone", "inputs", 0, "shape", 1, value="batch"),
        "graphs.backbone.inputs.0.shape.1: Input should be a valid integer",
    ),
    "a negative largest gap": (
        set_at("window", "largest_time_delta_s", value=-1.0),
        "window.largest_time_delta_s: Input should be greater than 0; got -1",
    ),
    "a negative largest speed": (
        set_at("window", "largest_speed_m_s", value=-1.0),
        "window.largest_speed_m_s: Input should be greater than 0; got -1",
    ),
}


@pytest.mark.parametrize("case", WRONG_FIELDS)
def test_a_wrong_field_is_reported_with_the_file_and_its_name(tmp_path, case):
    change, message = WRONG_FIELDS[case]
    write_manifest(tmp_path, SCHEMA_2)
    edit_manifest(tmp_path, change)
    with pytest.raises(ArtifactError) as error:
        read_manifest(tmp_path)
    assert str(error.value).startswith(f"{tmp_path / 'manifest.json'}: field {message}")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "expected JSON; got 0 characters"),
        ("graphs: all", "expected JSON; got 11 characters"),
        (json.dumps(SCHEMA_2)[:-1], "expected JSON"),
        ("[1]", "expected a JSON object; got \\[1\\]"),
        ("null", "expected a JSON object; got None"),
        ("[" * 200_000, "expected JSON"),
        ('{"schema_version": ' + "1" * 5000 + "}", "expected JSON"),
    ],
)
def test_a_file_that_is_not_a_manifest_is_refused(tmp_path, text, message):
    with pytest.raises(ArtifactError, match=rf"manifest\.json: {message}"):
        read_manifest(write_manifest(tmp_path, text))


def test_a_binary_file_is_refused(tmp_path):
    (tmp_path / "manifest.json").write_bytes(b"\x80\x02}q\x00.")
    with pytest.raises(ArtifactError, match=r"manifest\.json: expected UTF-8 text; got bytes that are not"):
        read_manifest(tmp_path)


def test_a_missing_folder_and_a_folder_without_a_manifest_are_refused(tmp_path):
    with pytest.raises(ArtifactError, match="nowhere: expected a bundle folder; got no such folder"):
        read_manifest(tmp_path / "nowhere")
    with pytest.raises(ArtifactError, match=r"with manifest\.json in it; got a folder without it"):
        read_manifest(tmp_path)


WRONG_TYPES = {
    "a number as text": set_at("num_cameras", value="6"),
    "a boolean as a number": set_at("num_cameras", value=True),
    "seconds as text": set_at("window", "largest_time_delta_s", value="2.0"),
}


@pytest.mark.parametrize("case", WRONG_TYPES)
def test_text_and_booleans_are_not_accepted_as_numbers(tmp_path, case):
    write_manifest(tmp_path, SCHEMA_2)
    with pytest.raises(ArtifactError):
        read_manifest(edit_manifest(tmp_path, WRONG_TYPES[case]))


# --- Absurd sizes -------------------------------------------------------------------------------------------------


def set_window(count):
    """Set the number of frames in every place that could confirm it."""

    def change(manifest):
        manifest["window"]["num_frames"] = count
        for tensor in manifest["graphs"]["decoder"]["inputs"]:
            tensor["shape"] = [count, *tensor["shape"][1:]]

    return change


IMAGE_SHAPE = ("graphs", "backbone", "inputs", 0, "shape")
ABSURD_SIZES = {
    "2**31 frames": (set_at("window", "num_frames", value=2**31), "window.num_frames: Input should be less than"),
    "2**31 frames in all places": (set_window(2**31), "window.num_frames: Input should be less than"),
    "2**400 frames": (set_at("window", "num_frames", value=2**400), "window.num_frames: "),
    "2**31 cameras": (set_at("num_cameras", value=2**31), "num_cameras: Input should be less than"),
    "2**31 pixels": (set_at("preprocessing", "width_px", value=2**31), "preprocessing.width_px: Input should be less"),
    "2**31 voxels": (set_at("perception", "size", 0, value=2**31), "perception.size.0: Input should be less than"),
    "2**60 elements": (set_at(*IMAGE_SHAPE, value=[2**30, 2**30]), "graphs.backbone.inputs.0.shape: Input should have"),
    "1000 axes": (
        set_at(*IMAGE_SHAPE, value=[1] * 1000),
        "graphs.backbone.inputs.0.shape: Input should have at most 8",
    ),
    "100,000 cached values": (
        set_at("memory", value=[f"value_{number}" for number in range(100_000)]),
        "memory: Tuple should have at most 256 items",
    ),
}


@pytest.mark.parametrize("case", ABSURD_SIZES)
def test_an_absurd_size_is_refused_without_allocating_it(tmp_path, case):
    """Without the limits, the check of the window made a list of all names of the decoder's inputs."""
    change, message = ABSURD_SIZES[case]
    write_manifest(tmp_path, SCHEMA_2)
    edit_manifest(tmp_path, change)
    tracemalloc.start()
    try:
        with pytest.raises(ArtifactError) as error:
            inspect_bundle(tmp_path)
        assert tracemalloc.get_traced_memory()[1] < 100e6
    finally:
        tracemalloc.stop()
    assert str(error.value).startswith(f"{tmp_path / 'manifest.json'}: field {message}")


# --- Precision -----------------------------------------------------------------------------------------------------


def test_an_int8_bundle_needs_a_quantization_record(tmp_path):
    write_sealed_manifest(tmp_path, SCHEMA_4 | {"quantization": None})
    with pytest.raises(ArtifactError, match="field quantization: expected the record of an int8 bundle; got none"):
        read_manifest(tmp_path)


def test_a_float32_bundle_has_no_quantization_record(tmp_path):
    write_sealed_manifest(tmp_path, SCHEMA_4 | {"precision": "float32"})
    with pytest.raises(ArtifactError, match="field quantization: expected null in a float32 bundle; got a record"):
        read_manifest(tmp_path)


def test_int8_is_refused_in_a_manifest_of_an_older_schema(tmp_path):
    write_sealed_manifest(tmp_path, SCHEMA_4 | {"schema_version": 3})
    with pytest.raises(ArtifactError, match="field attention: expected only since schema 4; got it in a manifest of"):
        read_manifest(tmp_path)


# --- The seal -----------------------------------------------------------------------------------------------------


def test_a_sealed_manifest_that_is_called_schema_1_is_refused(tiny_bundle, tmp_path):
    text = (tiny_bundle / "manifest.json").read_text()
    write_manifest(tmp_path, text.replace(f'"schema_version": {SCHEMA_VERSION}', '"schema_version": 1', 1))
    with pytest.raises(ArtifactError, match=r"manifest\.json: field sha256: expected only since schema 2"):
        read_manifest(tmp_path)


def sealed_text():
    """The lines of a sealed manifest: the last two are the seal and the closing brace."""
    with tempfile.TemporaryDirectory() as folder:
        return write_sealed_manifest(Path(folder), SCHEMA_2).joinpath("manifest.json").read_text().splitlines()


REMOVED_SEALS = {
    "no seal": lambda lines: "\n".join([*lines[:-3], lines[-3].rstrip(","), "}"]) + "\n",
    "null": lambda lines: "\n".join([*lines[:-2], ' "sha256": null', "}"]) + "\n",
    "an empty seal": lambda lines: "\n".join([*lines[:-2], ' "sha256": ""', "}"]) + "\n",
    "capital digits": lambda lines: "\n".join([*lines[:-2], lines[-2].upper().replace("SHA", "sha"), "}"]) + "\n",
    "the seal in the line of another field": lambda lines: "\n".join([*lines[:-3], lines[-3] + lines[-2], "}"]) + "\n",
    "the seal in the line of the closing brace": lambda lines: "\n".join([*lines[:-2], lines[-2] + "}"]) + "\n",
    "the seal as the first field": lambda lines: "\n".join(["{", lines[-2] + ",", *lines[1:-3], lines[-3][:-1], "}"]),
    "a line after the end": lambda lines: "\n".join([*lines, "", ""]),
}


@pytest.mark.parametrize("case", REMOVED_SEALS)
def test_a_manifest_whose_last_field_is_not_its_seal_is_refused(tmp_path, case):
    lines = sealed_text()
    read_manifest(write_manifest(tmp_path, "\n".join(lines) + "\n"))  # control
    with pytest.raises(ArtifactError, match=r"manifest\.json: field sha256: "):
        read_manifest(write_manifest(tmp_path, REMOVED_SEALS[case](lines)))


# --- Wrong graph files --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("graph", GRAPHS)
def test_a_bundle_without_one_of_its_graph_files_is_refused(copied_bundle, graph):
    (copied_bundle / f"{graph}.onnx").unlink()
    with pytest.raises(ArtifactError, match=rf"{graph}\.onnx: the bundle's {graph} graph is missing"):
        Pipeline.load(copied_bundle)


def test_a_truncated_graph_is_refused_before_it_is_loaded(copied_bundle):
    path = copied_bundle / "decoder.onnx"
    path.write_bytes(path.read_bytes()[:-1])
    with pytest.raises(ArtifactError, match=r"decoder\.onnx: field graphs\.decoder\.sha256"):
        Pipeline.load(copied_bundle)


@pytest.mark.parametrize(
    "file",
    [
        "../backbone.onnx",
        "/etc/hostname",
        "sub/backbone.onnx",
        "",
        ".",
        "..",
        "backbone.ort",
        "lifter.onnx",
        "BACKBONE.onnx",
    ],
)
def test_a_graph_file_of_another_name_is_refused(copied_bundle, file):
    shutil.copy(copied_bundle / "backbone.onnx", copied_bundle.parent)
    edit_manifest(copied_bundle, set_at("graphs", "backbone", "file", value=file))
    with pytest.raises(ArtifactError, match=r"graphs\.backbone\.file: expected 'backbone\.onnx'; got"):
        Pipeline.load(copied_bundle)


def test_sha256_is_the_hash_of_the_file_content(tmp_path):
    (tmp_path / "abc").write_bytes(b"abc")
    assert sha256(tmp_path / "abc") == "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"
