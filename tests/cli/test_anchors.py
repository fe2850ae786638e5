"""`duospacenet anchors`: from a source to a file, and from the file into the graphs' initial query poses."""

import json
import shutil
from dataclasses import replace

import numpy as np
import onnx
import pytest
from onnx import numpy_helper

from duospacenet.cli.main import run_app
from duospacenet.data.anchors_file import read_anchors
from duospacenet.data.scene_writer import write_scene
from duospacenet.export import bundle
from duospacenet.export.tracing import trace
from duospacenet.model import PRESETS, DuoSpaceNet, randomise
from duospacenet.runtime.bundle.manifest import read_manifest, sha256
from duospacenet.synthetic.drive import SyntheticDrive
from duospacenet.weights import save_checkpoint
from duospacenet.weights.provenance import hash_weights
from tests.helpers.checkpoints import write
from tests.helpers.parity_results import passing_result

DRIVE = "synthetic:5:4"
EXPORT = ["export", "--preset", "tiny"]


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    """Anchors for the 32 queries of the tiny preset."""
    path = tmp_path_factory.mktemp("anchors") / "anchors.json"
    assert run_app(["anchors", DRIVE, "--queries", "32", "--out", str(path)]) == 0
    return path


@pytest.fixture
def exported_model(reuse_traced_graphs, monkeypatch):
    """The exported models. Exports copy the graphs of `tiny_bundle` and skip the parity check."""
    models = []
    passed = passing_result()
    monkeypatch.setattr(bundle, "check_parity", lambda _, model, **__: models.append(model) or passed)
    return models


def without_poses(model, folder):
    """A checkpoint of `model` that lacks the queries' poses."""
    tensors = {name: tensor for name, tensor in model.state_dict().items() if name != "queries.pose"}
    return write(folder / "weights.safetensors", tensors)


# --- The file -----------------------------------------------------------------------------------------------------


def test_the_file_holds_the_centroids_of_the_true_boxes(file):
    anchors = read_anchors(file)
    boxes = np.concatenate([frame.ground_truth.boxes[:, :3] for frame in SyntheticDrive.parse(DRIVE)])
    near = boxes[(boxes**2).sum(axis=1) <= 55**2]
    assert (anchors.num_boxes, anchors.num_frames, anchors.range_m, anchors.seed) == (len(near), 4, 55.0, 0)
    assert anchors.source == DRIVE
    assert anchors.centres.shape == (32, 3)
    nearest = ((near[:, None] - anchors.centres) ** 2).sum(axis=-1).argmin(axis=1)
    means = [near[nearest == index].mean(axis=0) for index in range(32)]
    np.testing.assert_allclose(anchors.centres, means, atol=1e-9)


def test_the_same_seed_writes_the_same_bytes_and_another_seed_writes_others(file, tmp_path):
    for seed in ("0", "1"):
        assert run_app(["anchors", DRIVE, "--queries", "32", "--seed", seed, "--out", str(tmp_path / seed)]) == 0
    assert (tmp_path / "0").read_bytes() == file.read_bytes() != (tmp_path / "1").read_bytes()


def test_json_is_one_object_on_stdout(tmp_path, capfd):
    out = tmp_path / "anchors.json"
    assert run_app(["anchors", DRIVE, "--queries", "8", "--out", str(out), "--json"]) == 0
    summary = json.loads(capfd.readouterr().out)
    assert summary["anchors"] == str(out)
    assert (summary["queries"], summary["frames"]) == (8, 4)
    assert summary["boxes"] == read_anchors(out).num_boxes
    assert 0 < summary["distance_m"] < 55


REFUSED = {
    "too many queries": (
        ["synthetic:5:1", "--queries", "900"],
        3,
        "expected at least 900 different box centres within 55 m",
    ),
    "a short range": (
        [DRIVE, "--queries", "8", "--range", "1"],
        3,
        "box centres within 1 m, one per query; got 0 among",
    ),
    "no queries": ([DRIVE, "--queries", "0"], 2, "--queries"),
    "no source": (["nowhere", "--queries", "8"], 3, "nowhere: expected a scene folder"),
}


@pytest.mark.parametrize("call", REFUSED)
def test_invalid_arguments_are_refused_and_nothing_is_written(tmp_path, capfd, call):
    arguments, code, words = REFUSED[call]
    assert run_app(["anchors", *arguments, "--out", str(tmp_path / "anchors.json")]) == code
    assert words in capfd.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_an_existing_file_is_kept_and_nothing_is_read(tmp_path, capfd):
    (tmp_path / "mine").write_text("mine")
    assert run_app(["anchors", "nowhere", "--queries", "8", "--out", str(tmp_path / "mine")]) == 5
    assert "it exists already" in capfd.readouterr().err
    assert (tmp_path / "mine").read_text() == "mine"


def renamed_scene(folder, class_name):
    """A scene folder of one rendered frame with all boxes under another name."""
    frame = SyntheticDrive.parse("synthetic:5:1").frame(0)
    truth = frame.ground_truth
    write_scene(folder, [replace(frame, ground_truth=replace(truth, classes=(class_name,) * len(truth.classes)))])
    return str(folder)


def test_unknown_class_names_are_refused_unless_the_model_has_them(tmp_path, capfd):
    scene = renamed_scene(tmp_path / "scene", "Car")
    anchors = ["anchors", scene, "--queries", "4", "--out", str(tmp_path / "anchors.json")]
    assert run_app(anchors) == 3
    assert "got 'Car' (" in capfd.readouterr().err
    assert not (tmp_path / "anchors.json").exists()
    assert run_app([*anchors, "--class", "Van", "--class", "Car"]) == 0


def test_boxes_that_are_left_out_are_not_clustered_and_counted(tmp_path, capfd):
    scene = renamed_scene(tmp_path / "scene", "animal")
    assert run_app(["anchors", scene, "--queries", "1", "--out", str(tmp_path / "anchors.json")]) == 3
    message = capfd.readouterr().err
    assert "ground truth: left out " in message
    assert "of other classes: animal (" in message
    assert "at least 1 different box centres within 55 m, one per query; got 0 among 0 boxes" in message


def inside_a_file(folder):
    (folder / "file").write_text("mine")
    return folder / "file" / "anchors.json"


def deeper_inside_a_file(folder):
    return inside_a_file(folder).parent / "new" / "anchors.json"


def behind_a_broken_link(folder):
    (folder / "link").symlink_to("nowhere")
    return folder / "link" / "anchors.json"


def too_long(folder):
    return folder / ("a" * 300)


@pytest.mark.parametrize(
    ("prepare", "reason"),
    [
        (inside_a_file, "file is not writable (Not a directory)"),
        (deeper_inside_a_file, "file is not writable (Not a directory)"),
        (behind_a_broken_link, "link is not writable (No such file or directory)"),
        (too_long, "is not writable (File name too long)"),
    ],
)
def test_a_place_that_cannot_hold_a_file_is_refused_before_anything_is_read(tmp_path, capfd, prepare, reason):
    out = prepare(tmp_path)
    before = sorted(tmp_path.rglob("*"))
    assert run_app(["anchors", "nowhere", "--queries", "8", "--out", str(out)]) == 5
    err = capfd.readouterr().err
    assert f"{out}: expected a place for a new file; " in err
    assert f"{reason}. Choose another --out." in err
    assert sorted(tmp_path.rglob("*")) == before


@pytest.mark.parametrize("name", ["", ".", "new/", "new/..", "/"])
def test_a_name_that_cannot_be_a_file_is_refused(tmp_path, capfd, monkeypatch, name):
    monkeypatch.chdir(tmp_path)
    assert run_app(["anchors", "nowhere", "--queries", "8", "--out", name]) == 2
    assert f"--out: expected a file name; got {name!r}" in capfd.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_a_folder_is_refused_without_advice_to_remove_it(tmp_path, capfd):
    assert run_app(["anchors", "nowhere", "--queries", "8", "--out", str(tmp_path)]) == 5
    err = capfd.readouterr().err
    assert "expected a new file; it is a folder. Name a file in it, or choose another --out." in err
    assert "Remove" not in err


def test_the_help_names_the_unit_of_the_range(capfd):
    assert run_app(["anchors", "--help"]) == 0
    assert "in metres" in " ".join(capfd.readouterr().out.replace("│", " ").split())


def test_an_interruption_leaves_no_file(tmp_path, monkeypatch):
    def interrupt(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr("duospacenet.runtime.files.move_into_place", interrupt)
    assert run_app(["anchors", DRIVE, "--queries", "8", "--out", str(tmp_path / "anchors.json")]) == 130
    assert list(tmp_path.iterdir()) == []


# --- The export ---------------------------------------------------------------------------------------------------


def test_random_weights_start_from_the_anchors_and_are_otherwise_unchanged(exported_model, file, tiny_model, tmp_path):
    out = tmp_path / "bundle"
    assert run_app([*EXPORT, "--random-weights", "--anchors", str(file), "--out", str(out)]) == 0
    pose = exported_model[0].queries.pose.detach().numpy()
    np.testing.assert_array_equal(pose[:, :3], read_anchors(file).centres.astype(np.float32))
    for name, tensor in tiny_model.state_dict().items():
        if name == "queries.pose":
            np.testing.assert_array_equal(pose[:, 3:], tensor[:, 3:])
        else:
            assert tensor.equal(exported_model[0].state_dict()[name]), name


def test_the_manifest_records_the_anchors_file_and_the_resulting_weights(exported_model, file, tmp_path, capfd):
    out = tmp_path / "bundle"
    assert run_app([*EXPORT, "--random-weights", "--anchors", str(file), "--out", str(out)]) == 0
    weights = read_manifest(out).weights
    assert (weights.anchors.file, weights.anchors.sha256) == ("anchors.json", sha256(file))
    assert weights.sha256 == hash_weights(exported_model[0])
    assert run_app(["inspect", str(out)]) == 0
    assert "queries start at anchors.json" in capfd.readouterr().out


def test_a_checkpoint_without_poses_gets_them_from_the_anchors(exported_model, file, tiny_model, tmp_path):
    weights = without_poses(randomise(DuoSpaceNet(PRESETS["tiny"]), 9), tmp_path)
    arguments = ["--weights", str(weights), "--allow-missing", "queries.pose", "--anchors", str(file)]
    assert run_app([*EXPORT, *arguments, "--out", str(tmp_path / "bundle")]) == 0
    pose = exported_model[0].queries.pose.detach().numpy()
    np.testing.assert_array_equal(pose[:, :3], read_anchors(file).centres.astype(np.float32))
    assert read_manifest(tmp_path / "bundle").weights.anchors.file == "anchors.json"


def test_anchors_are_refused_for_a_checkpoint_with_poses(file, tiny_model, tmp_path, capfd):
    save_checkpoint(tmp_path / "tiny.safetensors", tiny_model)
    arguments = ["--weights", str(tmp_path / "tiny.safetensors"), "--anchors", str(file)]
    for more in ([], ["--allow-missing", "queries.*"]):
        assert run_app([*EXPORT, *arguments, *more, "--out", str(tmp_path / "bundle")]) == 2
        assert (
            "expected weights without queries.pose; tiny.safetensors contains trained query positions"
            in capfd.readouterr().err
        )
    assert not (tmp_path / "bundle").exists()


def test_the_wrong_number_of_anchors_is_refused(tmp_path, capfd):
    path = tmp_path / "eight.json"
    assert run_app(["anchors", DRIVE, "--queries", "8", "--out", str(path)]) == 0
    assert run_app([*EXPORT, "--random-weights", "--anchors", str(path), "--out", str(tmp_path / "bundle")]) == 4
    err = " ".join(capfd.readouterr().err.split())
    assert "eight.json: expected 32 anchors, one per query of tiny; got 8" in err
    assert "`duospacenet anchors --queries 32`" in err


def test_the_exported_graphs_start_from_the_anchors(file, tiny_bundle, tmp_path, monkeypatch, capfd):
    """The decoder's file holds the poses, and parity only holds with the same anchors.

    Only the decoder is traced: the other graphs do not depend on the query poses.
    """
    monkeypatch.setattr(
        bundle,
        "trace",
        lambda graph, path, dcn: (
            trace(graph, path, dcn) if graph.name == "decoder" else shutil.copy(tiny_bundle / path.name, path)
        ),
    )
    out = tmp_path / "bundle"
    assert run_app([*EXPORT, "--random-weights", "--anchors", str(file), "--out", str(out)]) == 0
    expected = read_anchors(file).centres.astype(np.float32)
    constants = [numpy_helper.to_array(tensor) for tensor in onnx.load(out / "decoder.onnx").graph.initializer]
    assert any(tensor.shape[-2:] == (32, 10) and np.allclose(tensor[..., :3], expected) for tensor in constants)
    capfd.readouterr()
    again = ["parity", str(out), "--random-weights", "--no-retrace"]
    assert run_app([*again, "--anchors", str(file)]) == 0
    assert "warning" not in capfd.readouterr().err
    assert run_app(again) == 1
    message = capfd.readouterr().err
    assert "queries from anchors.json (" in message
    assert "without --anchors" in message
