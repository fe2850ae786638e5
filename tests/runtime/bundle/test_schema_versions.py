"""A manifest has exactly the fields of its schema version."""

import copy
import json

import pytest

from duospacenet.runtime.bundle.manifest import read_manifest
from duospacenet.runtime.errors import ArtifactError
from tests.helpers.bundles import write_sealed_manifest
from tests.helpers.file_schemas import VALIDATORS
from tests.helpers.golden_manifest import SCHEMA_1, SCHEMA_2, SCHEMA_3, SCHEMA_4, SCHEMA_5
from tests.helpers.json_edits import deep_copy, delete_at, set_at
from tests.helpers.older_schemas import ADDED_FIELDS, downgrade

GOLDEN = {1: SCHEMA_1, 2: SCHEMA_2, 3: SCHEMA_3, 4: SCHEMA_4}
LATER_FIELDS = [
    (version, since, field)
    for version in GOLDEN
    for since, fields in ADDED_FIELDS.items()
    if since > version
    for field in fields
    if not (version == 1 and field.startswith("weights.checkpoint."))  # weights.checkpoint is refused before
]


def value_at(manifest, field):
    for key in field.split("."):
        manifest = manifest[key]
    return manifest


@pytest.mark.parametrize(("version", "since", "field"), LATER_FIELDS)
def test_a_field_of_a_later_schema_is_refused(tmp_path, version, since, field):
    """Otherwise an edited manifest could avoid a check by calling itself an older schema."""
    manifest = copy.deepcopy(GOLDEN[version])
    set_at(*field.split("."), value=value_at(SCHEMA_5, field))(manifest)
    if version == 1:
        write_unsealed(tmp_path, manifest)
    else:
        write_sealed_manifest(tmp_path, manifest)
    expected = f"expected only since schema {since}; got it in a manifest of schema {version}"
    with pytest.raises(ArtifactError, match=rf"manifest\.json: field {field}: {expected}"):
        read_manifest(tmp_path)


def write_unsealed(folder, manifest):
    (folder / "manifest.json").write_text(json.dumps(manifest))


def fields_of(value, place=()):
    """The places of all fields of a manifest, also inside of lists."""
    if isinstance(value, dict):
        for key, part in value.items():
            yield (*place, key)
            yield from fields_of(part, (*place, key))
    elif isinstance(value, list):
        for index, part in enumerate(value):
            yield from fields_of(part, (*place, index))


# Keys that are names, not fields. Any of them may be absent.
NAMES = {
    ("versions",),
    ("graphs",),
    ("frames_of_reference",),
    ("tensors",),
    ("weights", "checkpoint", "missing"),
    ("weights", "checkpoint", "ignored"),
    ("parity", "graphs"),
    ("parity", "graphs", "decoder"),
    ("parity", "coverage", "windows"),
    ("parity", "coverage", "motion"),
    ("parity", "coverage", "resets"),
    ("parity", "random_inputs"),
    ("parity", "elements"),
    ("quantization", "metrics", "float32", "map_iou"),
    ("quantization", "metrics", "simulated", "map_iou"),
    ("quantization", "metrics", "engine", "map_iou"),
}


def test_a_manifest_of_schema_5_has_every_field(tmp_path):
    places = [
        place
        for place in fields_of(SCHEMA_5)
        if place[:-1] not in NAMES and place[-1] not in ("", "schema_version", "sha256")
    ]
    assert len(places) > 200
    for place in places:
        manifest = deep_copy(SCHEMA_5)
        delete_at(*place)(manifest)
        write_sealed_manifest(tmp_path, manifest)
        with pytest.raises(ArtifactError, match=r"manifest\.json: field "):
            read_manifest(tmp_path)


@pytest.mark.parametrize("value", [False, True])
def test_the_deprecated_field_of_a_configuration_is_read_and_kept(tmp_path, value):
    manifest = deep_copy(SCHEMA_5)
    manifest["config"]["relu_before_extra_level"] = value
    write_sealed_manifest(tmp_path, manifest)
    assert read_manifest(tmp_path).config["relu_before_extra_level"] is value
    VALIDATORS["manifest", 5].validate(json.loads((tmp_path / "manifest.json").read_text()))


def test_the_deprecated_field_of_a_configuration_must_be_a_boolean(tmp_path):
    manifest = deep_copy(SCHEMA_5)
    manifest["config"]["relu_before_extra_level"] = 1
    write_sealed_manifest(tmp_path, manifest)
    with pytest.raises(ArtifactError, match=r"field config\.relu_before_extra_level: Input should be a valid boolean"):
        read_manifest(tmp_path)


@pytest.mark.parametrize("version", [1, 2, 3, 4])
def test_an_older_schema_has_the_rules_that_were_not_yet_in_the_file(tmp_path, version):
    manifest = copy.deepcopy(SCHEMA_5) | {"precision": "float32", "quantization": None}
    downgrade(manifest, version)
    if version == 1:
        write_unsealed(tmp_path, manifest)
    else:
        write_sealed_manifest(tmp_path, manifest)
    read = read_manifest(tmp_path).model_dump(mode="json")
    assert read["golden"] is None
    for field in ADDED_FIELDS[5]:
        assert field == "golden" or value_at(read, field) == value_at(SCHEMA_5, field)


def test_the_configuration_is_checked_field_by_field_since_schema_5(tmp_path):
    for value, message in (
        (0, "config.voxels.size.1: Input should be greater than 0; got 0"),
        ("16", "config.voxels.size.1: Input should be a valid integer; got '16'"),
    ):
        manifest = copy.deepcopy(SCHEMA_5)
        manifest["config"]["voxels"]["size"][1] = value
        write_sealed_manifest(tmp_path, manifest)
        with pytest.raises(ArtifactError, match=f"field {message}"):
            read_manifest(tmp_path)
        downgraded = manifest | {"precision": "float32", "quantization": None}
        downgrade(downgraded, 4)
        write_sealed_manifest(tmp_path, downgraded | {"quantization": None})
        assert read_manifest(tmp_path).config["voxels"]["size"][1] == value


@pytest.mark.parametrize("version", [4, 5])
def test_a_deeply_nested_configuration_is_read_or_refused_without_a_recursion_error(tmp_path, version):
    manifest = deep_copy(SCHEMA_5) | {"precision": "float32", "quantization": None}
    downgrade(manifest, version)
    for _ in range(400):
        manifest["config"] = {"image": manifest["config"]}
    write_sealed_manifest(tmp_path, manifest)
    if version == 4:
        assert read_manifest(tmp_path).schema_version == 4
    else:
        with pytest.raises(ArtifactError, match=r"manifest\.json: field config\."):
            read_manifest(tmp_path)
