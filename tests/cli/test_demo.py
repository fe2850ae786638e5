"""`duospacenet demo` from end to end."""

import json

import pytest

from duospacenet import weights
from duospacenet.cli import demo as demo_command
from duospacenet.cli.main import run_app
from duospacenet.jobs import demonstration
from duospacenet.runtime.bundle.manifest import read_manifest
from duospacenet.weights import save_checkpoint
from tests.helpers.output_files import add_user_files, assert_user_files_kept
from tests.helpers.scene_files import copy_tree


def test_a_demo_exports_runs_renders_and_evaluates_and_a_second_one_checks_parity_again(
    reuse_traced_graphs, tiny_model, tmp_path, monkeypatch, capfd
):
    monkeypatch.setattr(demonstration, "PRESET", "tiny")
    monkeypatch.setattr(demonstration, "SOURCE", "synthetic:7:6")
    monkeypatch.setattr(demonstration, "FRAME_SHOWN", 5)
    checkpoint = tmp_path.parent / f"{tmp_path.name}.safetensors"
    save_checkpoint(checkpoint, tiny_model, {"trained": "false"})
    monkeypatch.setattr(weights, "shipped_weights", lambda preset: checkpoint)
    add_user_files(tmp_path)
    results = []
    for _ in range(2):
        assert run_app(["demo", "--out", str(tmp_path)]) == 0
        printed = capfd.readouterr().out
        assert "equal to eager mode" in printed
        assert "NDS" in printed
        assert str(tmp_path / "pictures" / "000005.png") in printed
        results.append((tmp_path / "results.jsonl").read_text().splitlines())
    assert results[0] == results[1]
    assert len(list((tmp_path / "pictures").glob("0*.png"))) == len(results[0]) == 6
    assert (tmp_path / "video.mp4").stat().st_size > 0
    assert_user_files_kept(tmp_path)


@pytest.mark.parametrize(
    ("is_ours", "weights_are_new", "expected"),
    [(True, True, "export"), (True, False, "parity"), (False, True, "parity")],
)
def test_a_demo_only_exports_its_own_bundle_again_if_other_weights_are_shipped(
    tiny_bundle, tmp_path, monkeypatch, capfd, is_ours, weights_are_new, expected
):
    """A bundle that no demo wrote is kept, and its parity is checked."""
    bundle, done = tmp_path / "bundle", []
    copy_tree(tiny_bundle, bundle)
    (bundle / "old").touch()
    if is_ours:
        (tmp_path / "run.json").write_text(json.dumps({"demo": "synthetic:7:2"}))
    bundle_weights = read_manifest(bundle).weights.file_sha256
    monkeypatch.setattr(demonstration, "SOURCE", "synthetic:7:2")
    monkeypatch.setattr(demonstration, "sha256", lambda path: "new" if weights_are_new else bundle_weights)
    monkeypatch.setattr(demo_command, "parity", lambda bundle, weights: done.append("parity"))
    monkeypatch.setattr(
        demo_command, "export", lambda out, preset, weights: (copy_tree(tiny_bundle, out), done.append("export"))
    )
    assert run_app(["demo", "--out", str(tmp_path)]) == 0
    assert done == [expected]
    assert (bundle / "old").exists() == (expected == "parity")
    assert ("exported again" in capfd.readouterr().err) == (expected == "export")
