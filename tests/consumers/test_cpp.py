"""The C++ consumer computes the same boxes as Python, and refuses bad bundles, scenes and options."""

import json
import shutil
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tests.helpers import cpp_consumer
from tests.helpers.bundles import edit_manifest
from tests.helpers.camera_groups import copy_with_one_camera_per_run
from tests.helpers.consumer_drive import differences, read_lines, write_consumer_drive, write_python_results
from tests.helpers.scene_folders import write_example_scene

Scene = dict[str, Any]


@pytest.fixture(scope="module", autouse=True)
def built() -> None:
    cpp_consumer.build()


@pytest.fixture(scope="module")
def drive(portable_bundle, tmp_path_factory) -> Path:
    return write_consumer_drive(portable_bundle, tmp_path_factory.mktemp("drive") / "scene")


def run(bundle: Path, scene: Path, out: Path):
    return cpp_consumer.call(bundle, scene, "--out", out, "--threads", 1)


def test_the_unit_tests_pass():
    done = cpp_consumer.call(program=cpp_consumer.UNIT_TESTS)
    assert done.returncode == 0, done.stdout


def test_boxes_equal_those_of_python_over_a_drive_with_every_event(portable_bundle, drive, tmp_path):
    done = run(portable_bundle, drive, tmp_path / "cpp.jsonl")
    assert done.returncode == 0, done.stderr
    write_python_results(portable_bundle, drive, tmp_path / "python.jsonl", engine="openvino", threads=1)
    found, expected = (read_lines(tmp_path / f"{name}.jsonl") for name in ("cpp", "python"))
    assert differences(found, expected, tolerance=1e-4) == []
    assert [line["history"]["reset_reason"] for line in found] == [line["history"]["reset_reason"] for line in expected]
    assert sum(len(line["boxes"]) for line in found) > 1000


def test_a_backbone_of_one_camera_at_a_time_gives_the_same_boxes(portable_bundle, tiny_model, drive, tmp_path):
    bundle = copy_with_one_camera_per_run(portable_bundle, tiny_model, tmp_path / "bundle")
    for name, folder in {"all": portable_bundle, "one": bundle}.items():
        done = run(folder, drive, tmp_path / f"{name}.jsonl")
        assert done.returncode == 0, done.stderr
    found, expected = (read_lines(tmp_path / f"{name}.jsonl") for name in ("one", "all"))
    assert differences(found, expected, tolerance=1e-4) == []
    assert cpp_consumer.call(bundle, "--verify", "--threads", 1).returncode == 0


def change_field(path: str, value: Any) -> Callable[[Scene], None]:
    """Return a change of one field of a manifest or scene. path: keys and indices, separated by dots."""

    def change(content: Scene) -> None:
        *parents, last = (int(key) if key.isdigit() else key for key in path.split("."))
        part: Any = content
        for key in parents:
            part = part[key]
        part[last] = value

    return change


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (change_field("schema_version", 6), "schema_version"),
        (change_field("schema_version", 1), "schema_version"),
        (change_field("parity.passed", False), "parity.passed"),
        (change_field("parity", None), "parity"),
        (change_field("preprocessing.colour_order", "rgb"), "colour_order"),
        (change_field("preprocessing.crop_rounding", "up"), "crop_rounding"),
        (change_field("window.num_frames", 3), "image_T_ego"),
        (change_field("window.largest_time_delta_s", 0), "largest_time_delta_s"),
        (change_field("num_cameras", 5), "num_cameras"),
        (change_field("graphs.decoder.file", "../decoder.onnx"), "graphs.decoder.file"),
        (change_field("graphs.decoder.sha256", "0" * 64), "decoder.onnx"),
        (change_field("graphs.decoder.inputs.0.shape", [2, 2]), "decoder"),
        (change_field("graphs.decoder.inputs.0.shape", [2**20, 2**20]), "elements"),
        (change_field("classes", ["car"]), "class_logits"),
        (change_field("memory", ["bev"]), "slot0"),
        (change_field("memory", ["features"]), "features"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_a_wrong_manifest_is_refused(change, expected, copied_portable_bundle, tmp_path):
    edit_manifest(copied_portable_bundle, change)
    done = run(copied_portable_bundle, write_example_scene(tmp_path / "scene"), tmp_path / "out.jsonl")
    assert done.returncode == 4, done.stderr
    assert expected in done.stderr
    assert len(done.stderr.splitlines()) == 1
    assert not (tmp_path / "out.jsonl").exists()


def test_an_edited_manifest_and_an_edited_graph_are_refused(copied_portable_bundle):
    manifest = copied_portable_bundle / "manifest.json"
    text = manifest.read_text()
    manifest.write_text(text.replace('"largest_speed_m_s": 70.0', '"largest_speed_m_s": 71.0'))
    done = cpp_consumer.call(copied_portable_bundle, "--verify")
    assert (done.returncode, "field sha256" in done.stderr) == (4, True)
    manifest.write_text(text.replace('"preset"', '"preset": "a", "preset"', 1))
    done = cpp_consumer.call(copied_portable_bundle, "--verify")
    assert (done.returncode, "twice" in done.stderr) == (4, True)
    manifest.write_text(text)
    graph = copied_portable_bundle / "decoder.onnx"
    graph.write_bytes(graph.read_bytes()[:-1] + b"\0")
    done = cpp_consumer.call(copied_portable_bundle, "--verify")
    assert (done.returncode, "decoder.onnx" in done.stderr) == (4, True)
    graph.unlink()
    done = cpp_consumer.call(copied_portable_bundle, "--verify")
    assert (done.returncode, "no such file" in done.stderr) == (4, True)


NOT_A_NUMBER = [["NaN", 0, 8], [0, 10, 4], [0, 0, 1]]


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (change_field("schema_version", 2), "schema_version"),
        (change_field("frames", []), "frames"),
        (change_field("frames.0.timestamp_s", "now"), "timestamp_s"),
        (change_field("frames.0.timestamp_s", 1e12), "timestamp_s"),
        (change_field("frames.1.scene", "yard"), "timestamp_s"),
        (change_field("frames.0.weather", "rain"), "weather"),
        (change_field("frames.0.global_T_ego.0.0", 1.1), "global_T_ego"),
        (change_field("frames.0.global_T_ego", [[1, 0], [0, 1]]), "global_T_ego"),
        (change_field("cameras.LEFT.intrinsics_px", NOT_A_NUMBER), "intrinsics_px"),
        (change_field("cameras.LEFT.intrinsics_px.0.0", 1e6), "intrinsics_px"),
        (change_field("cameras.LEFT.distortion", [0.1]), "distortion"),
        (change_field("cameras.LEFT.width_px", 1.5), "width_px"),
        (change_field("frames.0.cameras.LEFT.image", "lost.png"), "lost.png"),
        (change_field("frames.0.cameras.LEFT.image", "../left.png"), "inside the scene folder"),
        (change_field("frames.0.cameras.LEFT.image", "/etc/hostname"), "inside the scene folder"),
        (change_field("frames.0.cameras.LEFT.image", "scene.json"), "JPEG or PNG"),
        (change_field("frames.0.cameras.LEFT.image", "right.png"), "8x8 px"),
        (change_field("frames.0.cameras.BACK", {"image": "left.png"}), "width_px"),
        (change_field("frames.0.token", "a\x1b[2J"), "control characters"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_a_bad_scene_is_refused(change, expected, portable_bundle, tmp_path):
    folder = write_example_scene(tmp_path / "scene")
    scene = json.loads((folder / "scene.json").read_text())
    scene["frames"][1]["timestamp_s"] = 9.0  # older, but in another scene
    change(scene)
    (folder / "scene.json").write_text(json.dumps(scene).replace('"NaN"', "NaN"))
    done = run(portable_bundle, folder, tmp_path / "out.jsonl")
    assert done.returncode == 3, done.stderr
    assert expected in done.stderr
    assert len(done.stderr.splitlines()) == 1
    assert "\x1b" not in done.stderr


def test_a_damaged_image_is_refused(portable_bundle, tmp_path):
    folder = write_example_scene(tmp_path / "scene")
    (folder / "left.png").write_bytes((folder / "left.png").read_bytes()[:-20])
    done = run(portable_bundle, folder, tmp_path / "out.jsonl")
    assert (done.returncode, "left.png: expected an undamaged image" in done.stderr) == (3, True)


def test_a_frame_that_the_history_refuses_ends_the_run_and_the_lines_before_it_stay(portable_bundle, tmp_path):
    folder = write_example_scene(tmp_path / "scene")
    scene = json.loads((folder / "scene.json").read_text())
    first = scene["frames"][0]
    elsewhere = first | {"scene": "street", "timestamp_s": 1.0, "cameras": {}}  # no image: the frame is skipped
    scene["frames"] = [first, elsewhere, first | {"timestamp_s": 9.0}]
    (folder / "scene.json").write_text(json.dumps(scene))
    done = run(portable_bundle, folder, tmp_path / "out.jsonl")
    assert done.returncode == 3
    assert "expected later than 10 of the frame before" in done.stderr
    assert [line["skipped"] is None for line in read_lines(tmp_path / "out.jsonl")] == [True, False]


def test_more_cameras_than_the_bundle_accepts_are_refused_before_the_first_frame(portable_bundle, tmp_path):
    folder = write_example_scene(tmp_path / "scene")
    scene = json.loads((folder / "scene.json").read_text())
    scene["cameras"] |= {f"camera {number}": scene["cameras"]["LEFT"] for number in range(5)}
    (folder / "scene.json").write_text(json.dumps(scene))
    done = run(portable_bundle, folder, tmp_path / "out.jsonl")
    assert (done.returncode, "at most 6 cameras" in done.stderr) == (3, True)
    assert not (tmp_path / "out.jsonl").exists()


def test_an_existing_file_stays_and_a_folder_that_is_missing_is_reported(portable_bundle, tmp_path):
    folder = write_example_scene(tmp_path / "scene")
    (tmp_path / "out.jsonl").write_text("mine")
    done = run(portable_bundle, folder, tmp_path / "out.jsonl")
    assert (done.returncode, (tmp_path / "out.jsonl").read_text()) == (5, "mine")
    assert run(portable_bundle, folder, tmp_path / "missing" / "out.jsonl").returncode == 5


def test_a_full_disk_is_reported(portable_bundle, drive, tmp_path):
    import resource

    def limit_file_size() -> None:
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, 100_000))

    done = cpp_consumer.call(
        portable_bundle, drive, "--out", tmp_path / "out.jsonl", "--threads", 1, preexec_fn=limit_file_size
    )
    assert (done.returncode, "disk full" in done.stderr) == (5, True)


@pytest.mark.parametrize(
    "arguments",
    [
        [],
        ["bundle"],
        ["bundle", "scene"],
        ["bundle", "--out", "out.jsonl"],
        ["bundle", "scene", "--out"],
        ["bundle", "scene", "other", "--out", "out.jsonl"],
        ["bundle", "--verify", "--threads", "0"],
        ["bundle", "--verify", "--threads", "two"],
        ["bundle", "--verfy"],
    ],
    ids=" ".join,
)
def test_wrong_usage_is_refused(arguments):
    assert cpp_consumer.call(*arguments).returncode == 2


def test_help_lists_the_options():
    done = cpp_consumer.call("--help")
    assert done.returncode == 0
    assert all(option in done.stdout for option in ("--out", "--verify", "--threads"))


def test_a_bundle_with_an_operator_that_openvino_lacks_is_refused_with_advice(copied_portable_bundle, tmp_path):
    import onnx

    from tests.helpers.bundles import edit_graph

    def rename_first_sample(model: onnx.ModelProto) -> None:
        next(node for node in model.graph.node if node.op_type == "GridSample").op_type = "DeformConv"

    edit_graph(copied_portable_bundle, "decoder", rename_first_sample)
    edit_manifest(copied_portable_bundle, change_field("dcn", "native"))
    done = run(copied_portable_bundle, write_example_scene(tmp_path / "scene"), tmp_path / "out.jsonl")
    assert (done.returncode, "--dcn grid-sample" in done.stderr) == (4, True), done.stderr
    shutil.rmtree(copied_portable_bundle)
