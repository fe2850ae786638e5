"""The JSON Schemas agree with the readers: `jsonschema`, an independent validator, accepts and refuses the same files.

`BEYOND_SCHEMAS` lists the rules that a reader has and a schema cannot express, or does not.
"""

import json
import math
import random
from pathlib import Path

import pytest
from jsonschema import Draft202012Validator

from duospacenet.data.results import FrameResultSchema
from duospacenet.data.scene_schema import SceneRecord
from duospacenet.data.scene_writer import write_scene
from duospacenet.jobs.inference import run
from duospacenet.jobs.json_schemas import FILE_FORMATS, schema_text
from duospacenet.runtime.bundle.golden_record import ExpectedValues
from duospacenet.runtime.bundle.manifest import read_manifest
from duospacenet.runtime.errors import ArtifactError, InputError
from duospacenet.runtime.json_record import check_record, parse_json
from duospacenet.synthetic.drive import SyntheticDrive
from tests.data.test_results import LINE
from tests.data.test_scene_folder import WRONG_FIELDS as WRONG_SCENES
from tests.helpers.bundles import write_sealed_manifest
from tests.helpers.file_schemas import EACH_FORMAT, VALIDATORS, validate, validate_bundle
from tests.helpers.golden_manifest import SCHEMA_1, SCHEMA_2, SCHEMA_3, SCHEMA_4, SCHEMA_5
from tests.helpers.json_edits import deep_copy
from tests.helpers.json_mutations import mutate
from tests.helpers.scene_folders import EXAMPLE_SCENE, write_example_scene
from tests.runtime.bundle.test_manifest import ABSURD_SIZES, WRONG_FIELDS, WRONG_TYPES

FOLDER = Path(__file__).parents[2] / "docs" / "schemas"
GOLDEN = {1: SCHEMA_1, 2: SCHEMA_2, 3: SCHEMA_3, 4: SCHEMA_4, 5: SCHEMA_5}


def is_valid(value, name, version):
    return VALIDATORS[name, version].is_valid(value)


@pytest.mark.parametrize(("name", "version"), EACH_FORMAT)
def test_the_published_schemas_are_generated_from_the_records(name, version):
    """After a change of a record: `make schemas`."""
    published = (FOLDER / f"{name}-{version}.schema.json").read_text()
    assert published == schema_text(name, version), "run `make schemas`"


@pytest.mark.parametrize(("name", "version"), EACH_FORMAT)
def test_a_schema_is_valid_and_names_its_version(name, version):
    schema = json.loads(schema_text(name, version))
    Draft202012Validator.check_schema(schema)
    assert schema["$schema"] == "https://json-schema.org/draft/2020-12/schema"
    assert schema["$id"] == f"urn:duospacenet:schema:{name}:{version}"
    assert schema["title"] == f"{name}, schema {version}"


def test_no_other_schema_is_published():
    names = sorted(path.name for path in FOLDER.iterdir())
    assert names == sorted(f"{name}-{version}.schema.json" for name, version in EACH_FORMAT)


def test_the_newest_version_is_the_default():
    assert schema_text("manifest") == schema_text("manifest", 5)


# --- Files that our code writes -----------------------------------------------------------------------------------


def test_an_exported_bundle_is_valid(tiny_bundle):
    validate_bundle(tiny_bundle)


def test_the_results_of_a_run_are_valid(tiny_bundle, tmp_path):
    run(tiny_bundle, "synthetic:7:3", tmp_path / "out", maps=True)
    results = tmp_path / "out" / "results.jsonl"
    assert all(line["boxes"] and line["maps"] for line in map(json.loads, results.read_text().splitlines()))
    validate(results, "results", 1)


def test_written_scene_folders_are_valid(tmp_path):
    write_scene(tmp_path / "drive", SyntheticDrive(3, frames=2, image_size=(160, 64)))
    validate(tmp_path / "drive" / "scene.json", "scene", 1)
    validate(write_example_scene(tmp_path / "yard") / "scene.json", "scene", 1)
    validate(FOLDER.parents[1] / "examples" / "scene_folder" / "scene.json", "scene", 1)


@pytest.mark.parametrize("version", GOLDEN)
def test_a_manifest_is_valid_in_its_own_schema_only(version):
    manifest = deep_copy(GOLDEN[version])
    VALIDATORS["manifest", version].validate(manifest)
    assert not any(is_valid(manifest, "manifest", other) for other in GOLDEN if other != version)


# --- Files that the readers refuse --------------------------------------------------------------------------------


@pytest.mark.parametrize("case", sorted({**WRONG_FIELDS, **WRONG_TYPES, **ABSURD_SIZES}))
def test_a_manifest_that_the_reader_refuses_is_not_valid(case):
    change = {**WRONG_FIELDS, **ABSURD_SIZES}[case][0] if case not in WRONG_TYPES else WRONG_TYPES[case]
    manifest = deep_copy(SCHEMA_2)
    assert is_valid(manifest, "manifest", 2)
    change(manifest)
    assert is_valid(manifest, "manifest", 2) == (case in BEYOND_SCHEMAS)


@pytest.mark.parametrize("case", WRONG_SCENES)
def test_a_scene_that_the_reader_refuses_is_not_valid(case):
    scene = deep_copy(EXAMPLE_SCENE)
    assert is_valid(scene, "scene", 1)
    WRONG_SCENES[case][0](scene)
    assert is_valid(scene, "scene", 1) == (case in BEYOND_SCHEMAS)


# Cases of the tables above, by the rule that no schema has.
BEYOND_SCHEMAS = {
    # JSON has no NaN and no infinity, so a JSON Schema does not exclude them.
    "NaN seconds",
    "infinite seconds",
    "a time stamp of NaN",
    "an infinite pose",
    # JSON Schema does not multiply.
    "2**60 elements",
    # Text that UTF-8 cannot encode.
    "a lone surrogate in a camera's name",
    # Matrices: rotations, and focal lengths within the limits of pinhole cameras.
    "a singular pose",
    "a negative focal length",
    "a transposed extrinsic",
    # Two places of a file together.
    "a camera without calibration",
    "a frame's camera with half a calibration",
    "no camera at all",
    "the same time stamp twice",
}


def leaves(value):
    if isinstance(value, dict):
        return [leaf for part in value.values() for leaf in leaves(part)]
    return [leaf for part in value for leaf in leaves(part)] if isinstance(value, list) else [value]


def whole_floats(value):
    """The number of values such as 16.0. JSON Schema takes them for integers, and the readers do not."""
    return sum(isinstance(leaf, float) and leaf.is_integer() for leaf in leaves(value))


def largest_shape(value):
    """The largest number of elements of any tensor in a file."""
    if isinstance(value, dict):
        shape = value.get("shape")
        is_shape = isinstance(shape, list) and all(isinstance(size, int) for size in shape)
        return max([math.prod(shape) if is_shape else 0, *map(largest_shape, value.values())])
    return max(map(largest_shape, value), default=0) if isinstance(value, list) else 0


def is_beyond_schemas(value):
    """Whether a reader refuses a file because it is not strict JSON, or because a tensor is too large."""
    if largest_shape(value) > 2**29:
        return True
    try:
        json.dumps(value, ensure_ascii=False, allow_nan=False).encode()
    except ValueError:
        return True
    return any(isinstance(leaf, int) and abs(leaf) >= 2**64 for leaf in leaves(value))


def reads_manifest(folder, value):
    write_sealed_manifest(folder, value)
    return reads(lambda: read_manifest(folder), ArtifactError)


def reads(read, error):
    try:
        read()
    except error:
        return False
    return True


def reader_of(name, folder):
    """A function that returns whether the reader of a format accepts a JSON value."""
    path = folder / "file.json"
    record = {"results": FrameResultSchema, "scene": SceneRecord, "expected": ExpectedValues}

    def read(value):
        if name == "manifest":
            return reads_manifest(folder, value)
        content = json.dumps(value).encode()
        return reads(
            lambda: check_record(path, parse_json(path, content, InputError), record[name], InputError), InputError
        )

    return read


EXPECTED = {
    "schema_version": 1,
    "tolerance": {"box": 1e-3, "score": 1e-3},
    "frames": [
        {
            "token": "first",
            "tensors": {
                "decoder.boxes": {
                    "shape": [1, 9],
                    "dtype": "float32",
                    "step": 1,
                    "compare": "each",
                    "tolerance": 1e-4,
                    "values": [1.5, 2.5, 0.5, 2.0, 4.5, 1.5, 0.25, None, 0.5],
                }
            },
        }
    ],
}
EXAMPLES = {"manifest": SCHEMA_5, "results": LINE, "scene": EXAMPLE_SCENE, "expected": EXPECTED}


@pytest.mark.parametrize("name", EXAMPLES)
def test_a_schema_and_its_reader_accept_the_same_changed_files(tmp_path, name):
    """Random changes of valid files, from a seed. Neither side may be stricter."""
    generator, read = random.Random(18), reader_of(name, tmp_path)
    version = FILE_FORMATS[name].versions[-1]
    example = deep_copy(EXAMPLES[name])
    assert read(example)
    assert is_valid(example, name, version)
    accepted = refused = 0
    while refused < 120:
        changed = mutate(generator, deep_copy(example))
        if is_beyond_schemas(changed) or whole_floats(changed) > whole_floats(example):
            continue
        if name == "manifest" and isinstance(changed, dict):
            changed["sha256"] = "0" * 64  # replaced by the hash when it is written
        valid = read(changed)
        assert is_valid(changed, name, version) == valid, [
            error.message for error in VALIDATORS[name, version].iter_errors(changed)
        ] or changed
        accepted, refused = accepted + valid, refused + (not valid)
    assert accepted > 5
