"""`duospacenet synthetic`: files of the synthetic world, for all that read nuScenes or scene folders."""

import json

import pytest

from duospacenet.cli.main import run_app
from duospacenet.data.scene_folder import SceneFolder

SMALL = ["--frames", "2", "--width", "160"]


def test_it_writes_a_nuscenes_root_and_says_how_to_read_it(tmp_path, capsys):
    out = tmp_path / "root"
    assert run_app(["synthetic", str(out), "--scenes", "2", *SMALL, "--json"]) == 0
    written = json.loads(capsys.readouterr().out)
    assert written == {"source": f"nuscenes:{out}", "scenes": ["scene-0061", "scene-0103"], "frames_per_scene": 2}
    assert len(json.loads((out / "v1.0-mini" / "sample.json").read_text())) == 4


def test_it_writes_a_scene_folder_with_several_scenes(tmp_path, capsys):
    out = tmp_path / "scenes"
    assert run_app(["synthetic", str(out), "--scenes", "2", *SMALL, "--format", "scene-folder", "--seed", "4"]) == 0
    assert f"wrote {out}: 2 scenes of 2 frames (synthetic-4, synthetic-5)" in capsys.readouterr().out
    frames = list(SceneFolder(out))
    assert [frame.scene for frame in frames] == ["synthetic-4"] * 2 + ["synthetic-5"] * 2
    assert frames[0].images["CAM_FRONT"].shape == (90, 160, 3)
    assert frames[3].ground_truth.maps["drivable_area"].any()


@pytest.mark.parametrize(
    ("options", "code", "message"),
    [
        (["--split", "validation"], 2, "--split: expected one of mini_train, mini_val, train, val, test"),
        (["--scenes", "3", "--split", "mini_val"], 2, "--scenes: expected at most 2"),
        (["--format", "scene-folder", "--split", "val"], 2, "a scene folder has no splits"),
        (["--format", "kitti"], 2, "'kitti'"),
        (["--scenes", "0"], 2, "greater than or equal to 1"),
    ],
)
def test_options_that_do_not_fit_are_refused_before_anything_is_written(tmp_path, capsys, options, code, message):
    assert run_app(["synthetic", str(tmp_path / "root"), *options]) == code
    assert message in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("file_format", ["nuscenes", "scene-folder"])
def test_an_existing_folder_and_an_unwritable_place_are_refused(tmp_path, capsys, file_format):
    (tmp_path / "file").write_text("")
    for out, message in ((tmp_path, "it exists already"), (tmp_path / "file" / "root", "cannot be written")):
        assert run_app(["synthetic", str(out), *SMALL, "--format", file_format]) == 5
        assert message in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["file"]
