"""Model repositories for Triton: their files, their configuration, and what is refused."""

import json
import math
import re
import shutil

import pytest

from duospacenet.jobs import package_triton
from duospacenet.jobs.serving.serving_options import ServingOptions
from duospacenet.jobs.serving.serving_tensors import INPUTS, serving_outputs
from duospacenet.jobs.serving.triton_config import config_text
from duospacenet.runtime.bundle.manifest import read_manifest
from duospacenet.runtime.errors import ArtifactError, OutputError, UsageError
from tests.helpers.bundles import edit_manifest

CONFIG = """\
name: "fleet"
backend: "python"
max_batch_size: 0  # a request is one frame of one vehicle

input [
  { name: "timestamp_s" data_type: TYPE_FP64 dims: [ 1 ] },
  { name: "global_T_ego" data_type: TYPE_FP64 dims: [ 4, 4 ] },
  { name: "camera_names" data_type: TYPE_STRING dims: [ -1 ] },
  { name: "images" data_type: TYPE_STRING dims: [ -1 ] },
  { name: "size_px" data_type: TYPE_INT32 dims: [ -1, 2 ] },
  { name: "intrinsics_px" data_type: TYPE_FP64 dims: [ -1, 3, 3 ] },
  { name: "camera_T_ego" data_type: TYPE_FP64 dims: [ -1, 4, 4 ] },
  { name: "scene" data_type: TYPE_STRING dims: [ 1 ] optional: true }
]
output [
  { name: "boxes" data_type: TYPE_FP32 dims: [ -1, 9 ] },
  { name: "scores" data_type: TYPE_FP32 dims: [ -1 ] },
  { name: "class_ids" data_type: TYPE_INT32 dims: [ -1 ] },
  { name: "attributes" data_type: TYPE_STRING dims: [ -1 ] },
  { name: "history_frames" data_type: TYPE_INT32 dims: [ 1 ] },
  { name: "reset_reason" data_type: TYPE_STRING dims: [ 1 ] },
  { name: "skipped" data_type: TYPE_STRING dims: [ 1 ] },
  { name: "dropped" data_type: TYPE_INT32 dims: [ 2 ] },
  { name: "maps" data_type: TYPE_FP32 dims: [ -1, 16, 16 ] }
]

sequence_batching {
  max_sequence_idle_microseconds: 2500000
  oldest { max_candidate_sequences: 4 }
  control_input [
    { name: "START" control [ { kind: CONTROL_SEQUENCE_START fp32_false_true: [ 0, 1 ] } ] },
    { name: "END" control [ { kind: CONTROL_SEQUENCE_END fp32_false_true: [ 0, 1 ] } ] }
  ]
}
instance_group [ { kind: KIND_CPU count: 3 } ]

parameters { key: "threads" value { string_value: "2" } }
parameters { key: "on_missing" value { string_value: "skip" } }
parameters { key: "history_step_s" value { string_value: "0.5" } }
"""


def files_of(folder):
    return sorted(path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file())


def test_the_configuration_has_the_options(tiny_bundle):
    options = ServingOptions("fleet", 10, 2.5, 3, 2, "skip", 0.5)
    assert config_text(read_manifest(tiny_bundle), options).startswith(CONFIG)


def test_a_bundle_without_map_classes_has_no_maps(tiny_bundle):
    manifest = read_manifest(tiny_bundle).model_copy(update={"map_classes": ()})
    assert "maps" not in [tensor.name for tensor in serving_outputs(manifest)]
    assert '"maps"' not in config_text(manifest, ServingOptions())


@pytest.mark.parametrize("name", ['say "car"', "back\\slash", "Öl\n} parameters {", "\x00"])
def test_no_class_name_can_end_a_string_of_the_configuration(tiny_bundle, name):
    manifest = read_manifest(tiny_bundle).model_copy(update={"classes": (name,)})
    (line,) = re.findall(r'^parameters \{ key: "classes" .*$', config_text(manifest, ServingOptions()), re.MULTILINE)
    assert line.isascii()
    literal = re.fullmatch(r'.*string_value: "((?:[^"\\]|\\[0-7]{3})*)" \} \}', line)[1]
    decoded = re.sub(r"\\([0-7]{3})", lambda match: chr(int(match[1], 8)), literal).encode("latin-1").decode()
    assert json.loads(decoded) == [name]


def test_a_repository_has_a_copy_of_the_whole_bundle_and_a_readme(tiny_bundle, tmp_path):
    out = tmp_path / "new" / "models"
    written = package_triton(tiny_bundle, out, ServingOptions(name="fleet", vehicles=3))
    bundle_files = [f"fleet/1/bundle/{name}" for name in files_of(tiny_bundle)]
    others = ["README.md", "check_sequences.py", "fleet/1/model.py", "fleet/config.pbtxt"]
    assert files_of(out) == sorted([*bundle_files, *others])
    for name in files_of(tiny_bundle):
        assert (out / "fleet/1/bundle" / name).read_bytes() == (tiny_bundle / name).read_bytes()
    readme = (out / "README.md").read_text()
    for tensor in (*INPUTS, *serving_outputs(read_manifest(tiny_bundle))):
        assert f"| `{tensor.name}` | {tensor.dtype} |" in readme
    assert "up to 3 vehicles" in readme
    assert written.to_dict()["vehicles"] == 3
    # The cached values of three past frames, as float32.
    graphs, memory = read_manifest(tiny_bundle).graphs, read_manifest(tiny_bundle).memory
    cached = [spec for graph in ("backbone", "lifter") for spec in graphs[graph].outputs if spec.name in memory]
    assert len(cached) == len(memory)
    assert written.state_mb == pytest.approx(3 * 4 * sum(math.prod(spec.shape) for spec in cached) / 1e6)


def test_an_existing_folder_is_replaced_only_on_request_and_only_if_it_is_a_repository(tiny_bundle, tmp_path):
    out = tmp_path / "models"
    package_triton(tiny_bundle, out)
    with pytest.raises(OutputError, match=r"expected a new folder; it exists already.*--overwrite"):
        package_triton(tiny_bundle, out)
    (out / "duospacenet/1/__pycache__").mkdir()
    package_triton(tiny_bundle, out, ServingOptions(name="fleet"), overwrite=True)
    assert (out / "fleet").is_dir()
    assert not (out / "duospacenet").exists()
    assert [path.name for path in tmp_path.iterdir()] == ["models"]


@pytest.mark.parametrize("foreign", ["notes.txt", "another_model/config.pbtxt", "duospacenet/2/model.py"])
def test_a_repository_with_other_files_is_not_replaced(tiny_bundle, tmp_path, foreign):
    out = tmp_path / "models"
    package_triton(tiny_bundle, out)
    (out / foreign).parent.mkdir(parents=True, exist_ok=True)
    (out / foreign).write_text("mine")
    before = files_of(out)
    with pytest.raises(OutputError, match="with no other files in it"):
        package_triton(tiny_bundle, out, overwrite=True)
    assert files_of(out) == before


def test_a_link_a_file_and_an_empty_folder_are_not_replaced(tiny_bundle, tmp_path):
    package_triton(tiny_bundle, tmp_path / "models")
    (tmp_path / "link").symlink_to(tmp_path / "models")
    (tmp_path / "dangling").symlink_to(tmp_path / "none")
    (tmp_path / "file").write_text("mine")
    (tmp_path / "empty").mkdir()
    for name in ("link", "dangling", "file", "empty"):
        with pytest.raises(OutputError, match="something else"):
            package_triton(tiny_bundle, tmp_path / name, overwrite=True)


def test_a_folder_inside_the_bundle_is_refused(copied_bundle):
    with pytest.raises(UsageError, match="expected a folder outside the bundle"):
        package_triton(copied_bundle, copied_bundle / "models")


def test_a_repository_can_be_made_from_the_bundle_that_it_replaces(tiny_bundle, tmp_path):
    out = tmp_path / "models"
    package_triton(tiny_bundle, out)
    package_triton(out / "duospacenet/1/bundle", out, ServingOptions(vehicles=2), overwrite=True)
    assert files_of(out / "duospacenet/1/bundle") == files_of(tiny_bundle)


def test_an_interruption_leaves_the_earlier_repository_and_no_other_file(tiny_bundle, tmp_path, monkeypatch):
    out = tmp_path / "models"
    package_triton(tiny_bundle, out)
    before = (out / "README.md").stat().st_ino

    def interrupt(*arguments):
        raise KeyboardInterrupt

    monkeypatch.setattr(shutil, "copyfile", interrupt)
    with pytest.raises(KeyboardInterrupt):
        package_triton(tiny_bundle, out, overwrite=True)
    assert (out / "README.md").stat().st_ino == before
    assert [path.name for path in tmp_path.iterdir()] == ["models"]


def test_a_damaged_bundle_is_refused(copied_bundle, tmp_path):
    (copied_bundle / "lifter.onnx").write_bytes(b"damaged")
    with pytest.raises(ArtifactError, match=r"lifter\.onnx: field graphs\.lifter\.sha256"):
        package_triton(copied_bundle, tmp_path / "models")
    assert not (tmp_path / "models").exists()


def test_a_bundle_without_a_passed_parity_report_is_refused(copied_bundle, tmp_path):
    edit_manifest(copied_bundle, lambda manifest: manifest.update(parity=None))
    with pytest.raises(ArtifactError, match="expected a passed parity report"):
        package_triton(copied_bundle, tmp_path / "models")


def test_a_bundle_with_a_link_is_refused(copied_bundle, tmp_path):
    (copied_bundle / "secret").symlink_to("/etc/passwd")
    with pytest.raises(ArtifactError, match="got a symbolic link"):
        package_triton(copied_bundle, tmp_path / "models")
    assert list(tmp_path.iterdir()) == [copied_bundle]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"name": "../fleet"}, "--name: expected up to 64 letters"),
        ({"name": ""}, "--name: expected"),
        ({"name": "fleet\n"}, "--name: expected"),
        ({"name": "readme.md"}, "--name: expected a name that no file of the repository has"),
        ({"name": "check_sequences.py"}, "--name: expected a name that no file of the repository has"),
        ({"vehicles": 0}, "--vehicles: expected 1 to 4096; got 0"),
        ({"vehicles": 2, "instances": 3}, "--instances: expected 1 to 2; got 3"),
        ({"idle_s": 1.5}, "--idle-seconds: expected 2 to 86400; got 1.5"),
        ({"idle_s": float("nan")}, "--idle-seconds: expected 2 to 86400; got nan"),
        ({"threads": 5000}, "threads: expected 1 to 1024"),
        ({"on_missing": "stop"}, "on_missing: expected blank, skip or error"),
        ({"history_step_s": 3.0}, "history step: expected 0.01 to 2 s"),
    ],
)
def test_options_that_do_not_fit_are_refused(tiny_bundle, tmp_path, options, message):
    with pytest.raises(UsageError, match=re.escape(message)):
        package_triton(tiny_bundle, tmp_path / "models", ServingOptions(**options))
    assert not (tmp_path / "models").exists()


def test_vehicles_are_shared_by_instances_and_rounded_up():
    assert ServingOptions(vehicles=7, instances=3).sequences_per_instance == 3
