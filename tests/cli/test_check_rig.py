"""`duospacenet check-rig` from end to end: its files, its output and its exit codes."""

import json

import cv2
import numpy as np
import pytest

from duospacenet.cli.main import run_app
from tests.helpers.output_files import parse_strict_json
from tests.helpers.rigs import AZIMUTHS_DEG, change_extrinsics, change_intrinsics, write_rig

LONG_NAME = "a name that is longer than eighty letters and contains / and .., as no file name may " * 2


def inverted(scene):
    change_extrinsics("FRONT", np.linalg.inv)(scene)


def half_resolution(scene):
    change_intrinsics("FRONT", lambda k: np.diag([0.5, 0.5, 1]) @ k)(scene)


def check(folder, out, *options):
    return run_app(["check-rig", str(folder), "--out", str(out), *options])


def files_in(folder):
    return sorted(path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file())


def test_a_valid_rig_ends_with_0_and_writes_all_numbers_and_pictures(tmp_path, capfd):
    assert check(write_rig(tmp_path / "rig"), tmp_path / "out") == 0
    printed = capfd.readouterr()
    assert "rig: ok" in printed.out
    assert all(name in printed.out for name in AZIMUTHS_DEG)
    assert "error" not in printed.err
    pictures = [f"cameras/{name}.png" for name in sorted(AZIMUTHS_DEG)]
    assert files_in(tmp_path / "out") == [*pictures, "coverage.png", "rig.json"]
    assert all(cv2.imread(str(tmp_path / "out" / name)) is not None for name in [*pictures, "coverage.png"])
    report = parse_strict_json((tmp_path / "out" / "rig.json").read_text())
    assert report["verdict"] == report["drive"]["verdict"] == "ok"
    left = report["cameras"]["LEFT"]
    assert left["picture"] == "cameras/LEFT.png"
    assert left["position_m"] == [1.0, 0.5, 1.5]
    assert (left["azimuth_deg"], left["determinant"], left["orthonormality_error"]) == (90.0, 1.0, 0.0)
    assert left["field_of_view_deg"]["horizontal"] == 90.0
    assert left["coverage"]["nearest_ground_m"] == 3.0
    assert set(left["coverage"]["overlap"]) == {"FRONT", "BACK", "RIGHT"}
    assert sum(report["rig"]["voxels_seen_by"].values()) == pytest.approx(1, abs=1e-5)
    assert report["drive"] | {"findings": 0} == {
        "verdict": "ok",
        "findings": 0,
        "frames": 3,
        "median_step_s": 0.5,
        "median_speed_m_s": 8.0,
    }
    assert [row["frame"] for row in report["looked_at"]] == [0, 1, 2]
    assert report["looked_at"][0]["cameras"]["LEFT"] == {"image_px": [160, 80], "calibration_px": [160, 80]}


def test_a_broken_rig_ends_with_1_and_names_the_camera_and_the_cause(tmp_path, capfd):
    assert check(write_rig(tmp_path / "rig", inverted), tmp_path / "out") == 1
    printed = capfd.readouterr()
    assert "the matrix is ego_T_camera" in printed.out
    assert "rig: broken" in printed.out
    assert "error: broken: camera FRONT. See" in printed.err
    assert "Traceback" not in printed.err
    report = parse_strict_json((tmp_path / "out" / "rig.json").read_text())
    assert [camera["verdict"] for camera in report["cameras"].values()] == ["broken", "ok", "ok", "ok"]
    assert set(report["cameras"]["FRONT"]["findings"][0]) == {
        "subject",
        "verdict",
        "expected",
        "got",
        "cause",
        "remedy",
        "frame",
        "num_frames",
    }


def test_a_suspect_rig_ends_with_0(tmp_path, capfd):
    assert check(write_rig(tmp_path / "rig", half_resolution), tmp_path / "out") == 0
    assert "rig: suspect" in capfd.readouterr().out


def test_a_broken_drive_ends_with_1_although_all_cameras_are_ok(tmp_path, capfd):
    def older(scene):
        scene["frames"][2]["timestamp_s"] = 0.0

    assert check(write_rig(tmp_path / "rig", older), tmp_path / "out") == 1
    assert "error: broken: the drive." in capfd.readouterr().err


def test_with_json_stdout_holds_only_the_report(tmp_path, capfd):
    assert check(write_rig(tmp_path / "rig", inverted), tmp_path / "out", "--json") == 1
    report = parse_strict_json(capfd.readouterr().out)
    assert report == json.loads((tmp_path / "out" / "rig.json").read_text())


def test_a_bundle_sets_the_voxels_and_the_image_crop(tiny_bundle, tmp_path):
    folder = write_rig(tmp_path / "rig")
    assert check(folder, tmp_path / "whole") == 0
    assert check(folder, tmp_path / "cut", "--bundle", str(tiny_bundle)) == 0
    whole, cut = (json.loads((tmp_path / out / "rig.json").read_text()) for out in ("whole", "cut"))
    assert whole["voxels"]["size"] == [100, 100, 4]
    assert whole["seen_through"] is None
    assert cut["voxels"]["size"] == [16, 16, 4]
    assert cut["seen_through"] == {"width_px": 160, "height_px": 64}
    magenta = (cv2.imread(str(tmp_path / "cut" / "cameras" / "FRONT.png")) == (255, 90, 255)).all(axis=2)
    # The upper 16 of 80 rows are cut, at 8 px a row.
    assert magenta[127:129, 20:1260].all()
    assert not magenta[60:120].any()


def test_more_cameras_than_the_bundle_supports_end_with_1(tiny_bundle, tmp_path, capfd):
    def seven(scene):
        for index in range(3):
            scene["cameras"][f"ROOF{index}"] = scene["cameras"]["FRONT"] | {"width_px": 161 + index}

    assert check(write_rig(tmp_path / "rig", seven), tmp_path / "out", "--bundle", str(tiny_bundle)) == 1
    assert "expected 1 to 6, as the bundle was exported; got 7" in capfd.readouterr().out


def test_synthetic_drives_are_sources_too(tmp_path, capfd):
    assert check("synthetic:5:2", tmp_path / "out", "--frames", "1", "--json") == 0
    assert len(json.loads(capfd.readouterr().out)["looked_at"]) == 1


def test_files_of_oddly_named_cameras_stay_in_the_folder(tmp_path, capfd):
    def renamed(scene):
        names = dict(zip(AZIMUTHS_DEG, ("../up", "a/b", "[red]x[/red]", LONG_NAME), strict=True))
        scene["cameras"] = {names[name]: camera for name, camera in scene["cameras"].items()}
        for frame in scene["frames"]:
            frame["cameras"] = {names[name]: camera for name, camera in frame["cameras"].items()}

    assert check(write_rig(tmp_path / "rig", renamed), tmp_path / "out") == 0
    assert "[red]x[/red]" in capfd.readouterr().out
    assert len([name for name in files_in(tmp_path / "out") if name.startswith("cameras/")]) == 4
    assert sorted(path.name for path in tmp_path.iterdir()) == ["out", "rig"]


def test_a_second_check_needs_overwrite_and_keeps_the_users_files(tmp_path, capfd):
    folder, out = write_rig(tmp_path / "rig"), tmp_path / "out"
    assert check(folder, out) == 0
    (out / "cameras" / "mine.png").write_bytes(b"mine")
    report = (out / "rig.json").read_bytes()
    assert check(folder, out) == 5
    assert "an earlier check wrote this" in capfd.readouterr().err
    assert (out / "rig.json").read_bytes() == report
    for _ in range(2):
        assert check(folder, out, "--overwrite") == 0

    def without_back(scene):
        del scene["cameras"]["BACK"]
        for frame in scene["frames"]:
            del frame["cameras"]["BACK"]

    assert check(write_rig(tmp_path / "three", without_back), out, "--overwrite") == 0
    names = ["FRONT", "LEFT", "RIGHT", "mine"]
    assert files_in(out) == [*(f"cameras/{name}.png" for name in names), "coverage.png", "rig.json"]
    assert (out / "cameras" / "mine.png").read_bytes() == b"mine"


def in_cameras(scene):
    for frame in scene["frames"]:
        for name in frame["cameras"]:
            frame["cameras"][name]["image"] = f"cameras/{name}.png"


def write_rig_with_images_in_cameras(folder):
    write_rig(folder, in_cameras)
    (folder / "cameras").mkdir()
    for name in AZIMUTHS_DEG:
        (folder / f"{name}.png").rename(folder / "cameras" / f"{name}.png")
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.mark.parametrize("source", [".", "scene.json"])
@pytest.mark.parametrize("out", [".", "cameras/..", "../link"])
def test_pictures_are_never_written_over_the_source(tmp_path, capfd, source, out):
    before = write_rig_with_images_in_cameras(tmp_path / "rig")
    (tmp_path / "link").symlink_to(tmp_path / "rig")
    assert check(tmp_path / "rig" / source, tmp_path / "rig" / out, "--overwrite") == 2
    assert "--out: expected a folder other than the source's" in capfd.readouterr().err
    assert {path: path.read_bytes() for path in (tmp_path / "rig").rglob("*") if path.is_file()} == before


@pytest.mark.parametrize("report", [None, '{"cameras": {}}', "[1]"])
def test_a_picture_that_no_report_lists_is_kept(tmp_path, capfd, report):
    """For example, `cameras/FRONT.png` may be an image of a scene with its scene.json in another folder."""
    folder, out = write_rig(tmp_path / "rig"), tmp_path / "out"
    (out / "cameras").mkdir(parents=True)
    (out / "cameras" / "FRONT.png").write_bytes(b"mine")
    if report:
        (out / "rig.json").write_text(report)
    assert check(folder, out, "--overwrite") == 5
    assert "shows that check-rig wrote this file" in capfd.readouterr().err
    assert (out / "cameras" / "FRONT.png").read_bytes() == b"mine"
    assert (out / "rig.json").exists() == (report is not None)


@pytest.mark.parametrize("picture", ["../rig/FRONT.png", "/etc/passwd", "cameras/../../rig/FRONT.png", 7, None])
def test_other_files_that_a_report_lists_are_not_removed(tmp_path, picture):
    folder, out = write_rig(tmp_path / "rig"), tmp_path / "out"
    out.mkdir()
    (out / "rig.json").write_text(json.dumps({"cameras": {"FRONT": {"picture": picture}}}))
    assert check(folder, out, "--overwrite", "--frames", "1") == 0
    assert (folder / "FRONT.png").is_file()


def damaged_json(folder):
    write_rig(folder)
    (folder / "scene.json").write_text('{"schema_version": 1,')


def without_a_field(folder):
    write_rig(folder, lambda scene: scene["cameras"]["FRONT"].pop("width_px"))


REFUSED_CALLS = {
    "no such folder": (lambda folder: None, [], 3, "got no such path"),
    "broken JSON": (damaged_json, [], 3, "expected JSON"),
    "a field is missing": (without_a_field, [], 3, "field cameras.FRONT.width_px"),
    "no such bundle": (write_rig, ["--bundle", "/none"], 4, "expected a bundle folder"),
    "no frames": (write_rig, ["--frames", "0"], 2, "frames"),
    "out twice": (write_rig, ["--out", "other"], 2, "--out: expected at most once; got it 2 times"),
}
REFUSED_OUTPUTS = {
    "a file": ("{rig}/scene.json", "expected a folder; got a file"),
    "cannot be made": ("/proc/none/out", "cannot be written"),
}


@pytest.mark.parametrize("case", REFUSED_CALLS)
def test_a_refused_call_ends_with_its_exit_code_and_a_message(tmp_path, capfd, case):
    make, options, code, words = REFUSED_CALLS[case]
    make(tmp_path / "rig")
    assert check(tmp_path / "rig", tmp_path / "out", *options) == code
    assert_one_message(capfd, words)


@pytest.mark.parametrize("case", REFUSED_OUTPUTS)
def test_an_output_that_cannot_be_a_folder_is_refused(tmp_path, capfd, case):
    out, words = REFUSED_OUTPUTS[case]
    write_rig(tmp_path / "rig")
    assert check(tmp_path / "rig", out.format(rig=tmp_path / "rig")) == 5
    assert_one_message(capfd, words)


def assert_one_message(capfd, words):
    printed = capfd.readouterr()
    assert words in printed.err
    assert "Traceback" not in printed.err
    assert "internal error" not in printed.err
    assert printed.out == ""


def test_an_invalid_synthetic_drive_is_refused(tmp_path, capfd):
    assert check("synthetic:x", tmp_path / "out") == 3
    assert "synthetic:SEED" in capfd.readouterr().err


def test_the_help_explains_the_verdicts(capfd):
    assert run_app(["check-rig", "--help"]) == 0
    printed = capfd.readouterr().out
    assert all(
        word in printed for word in ("Usage: duospacenet check-rig", "suspect", "broken", "--bundle", "--frames")
    )
