"""Importing a checkpoint on the command line: the report, what may be missing, and what the bundle says of it."""

import json
from pathlib import Path

import pytest
import torch

from duospacenet.cli.main import run_app
from duospacenet.export import ParityResult, bundle
from duospacenet.runtime.bundle.manifest import read_manifest
from tests.helpers.checkpoints import in_mmdetection3d_names, write

IMAGENET = Path(__file__).resolve().parents[2] / "../shared/data/resnet50_imagenet/resnet50_caffe_imagenet.safetensors"
DRY_RUN = ["export", "--preset", "tiny", "--dry-run", "--weights"]
HEADS = {"pts_bbox_head.cls.weight": torch.zeros(3), "depth_branch.conv.bias": torch.zeros(3)}
FRAMES = ["--source", "synthetic:3:2"]


@pytest.fixture(scope="module")
def detector(tiny_model, tmp_path_factory) -> Path:
    """An mmdetection3d checkpoint of the image encoder of `tiny_model`; the rest of that is drawn from seed 0."""
    named = in_mmdetection3d_names(tiny_model.state_dict())
    path = tmp_path_factory.mktemp("weights") / "epoch_24.pth"
    return write(path, {"state_dict": named | HEADS, "meta": {"epoch": 24}})


@pytest.fixture(scope="module")
def drawn_names(tiny_model) -> list[str]:
    """What the detector lacks, less the counters that nobody needs."""
    return [
        name
        for name in tiny_model.state_dict()
        if not name.startswith("image_encoder.") and not name.endswith("num_batches_tracked")
    ]


@pytest.fixture
def instant_export(reuse_traced_graphs, monkeypatch):
    """The graphs of `tiny_bundle` instead of traced ones, and no proof: the tests here look at the manifest."""
    passed = ParityResult(source="none", frames=0, graphs={}, stream=[], dead_inputs=[])
    monkeypatch.setattr(bundle, "check_parity", lambda *_, **__: passed)


@pytest.fixture
def imported(instant_export, detector, tmp_path) -> Path:
    """A bundle of the detector's weights, everything else drawn."""
    arguments = ["export", "--preset", "tiny", "--weights", str(detector), "--allow-missing", "[!i]*"]
    assert run_app([*arguments, "--out", str(tmp_path / "bundle")]) == 0
    return tmp_path / "bundle"


# --- The dry run --------------------------------------------------------------------------------------------------


def test_a_dry_run_prints_what_is_missing_and_ends_with_4_and_writes_nothing(detector, drawn_names, tmp_path, capfd):
    before = sorted(detector.parent.iterdir())
    assert run_app([*DRY_RUN, str(detector)]) == 4
    out = " ".join(capfd.readouterr().out.split())
    assert "epoch_24.pth: mmdetection3d's names of an image backbone and neck, inside state_dict" in out
    assert f"refused: {len(drawn_names)} missing: lifter.reduction.weight" in out
    assert "--allow-missing PATTERN" in out
    assert "must have been trained with the preprocessing" in out
    assert "ReLU" not in out
    assert sorted(detector.parent.iterdir()) == before


def test_a_dry_run_of_what_would_be_accepted_ends_with_0(detector, drawn_names, tiny_model, capfd):
    assert run_app([*DRY_RUN, str(detector), "--allow-missing", "[!i]*"]) == 0
    printed = capfd.readouterr()
    num_matched = sum(name.startswith("image_encoder.") for name in tiny_model.state_dict())
    assert f"accepted: {num_matched} tensors matched, {len(drawn_names)} allowed to be missing" in printed.out
    assert printed.err == ""


def test_a_dry_run_as_json_has_every_name(detector, drawn_names, capfd):
    patterns = ["--allow-missing", "decoder.*", "--allow-missing", "nothing.*"]
    assert run_app([*DRY_RUN, str(detector), *patterns, "--json"]) == 4
    printed = capfd.readouterr()
    report = json.loads(printed.out)
    assert report["checkpoint"] == "epoch_24.pth"
    assert report["accepted"] is False
    assert report["layout"] == "mmdetection3d"
    assert report["wrappers"] == ["state_dict"]
    assert report["missing"] == [name for name in drawn_names if not name.startswith("decoder.")]
    assert report["allowed_missing"] == {name: "decoder.*" for name in drawn_names if name.startswith("decoder.")}
    assert report["left_aside"] == list(HEADS)
    assert report["matched"]["image_encoder.neck.lateral.1.bias"] == "img_neck.lateral_convs.1.conv.bias"
    assert len([note for note in report["notes"] if "nothing missing matches: nothing.*" in note]) == 1
    assert printed.err == ""


def test_a_dry_run_lists_the_faults_in_a_table(tiny_model, tmp_path, capfd, monkeypatch):
    monkeypatch.setattr("duospacenet.cli.checkpoint_table.results.width", 160)
    tensors = dict(tiny_model.state_dict())
    tensors["queries.pose"] = torch.zeros(32, 9)
    tensors["lifter.reduction.weight"] = torch.zeros(8, 32, 1, 1, dtype=torch.int64)
    tensors["decoder.layers.0.cross_attention.bev.norm.bias"] = torch.full((32,), torch.nan)
    tensors["teacher.weight"] = tensors.pop("queries.content")
    assert run_app([*DRY_RUN, str(write(tmp_path / "weights.safetensors", tensors))]) == 4
    rows = [[cell.strip() for cell in line.split("│")[1:4]] for line in capfd.readouterr().out.splitlines()]
    for row in (
        ["missing", "1", "queries.content"],
        ["unexpected", "1", "teacher.weight"],
        ["mis-shaped", "1", "queries.pose (expected (32, 10), got (32, 9))"],
        ["not finite", "1", "decoder.layers.0.cross_attention.bev.norm.bias"],
        ["left aside", "0", ""],
    ):
        assert row in rows
    assert any(row[:2] == ["mis-typed", "1"] and "got torch.int64" in row[2] for row in rows if row)


@pytest.mark.skipif(not IMAGENET.exists(), reason="the ImageNet weights are not beside the checkout")
def test_the_real_imagenet_weights_are_reported_for_small(capfd):
    arguments = ["export", "--preset", "small", "--weights", str(IMAGENET), "--dry-run", "--json"]
    assert run_app(arguments) == 4
    assert run_app([*arguments, "--allow-missing", "[!i]*", "--allow-missing", "image_encoder.neck.*"]) == 0
    refused, accepted = map(json.loads, capfd.readouterr().out.splitlines())
    assert [len(report["matched"]) for report in (refused, accepted)] == [318, 318]
    assert refused["missing"] == list(accepted["allowed_missing"])
    assert accepted["left_aside"] == ["fc.bias", "fc.weight"]


USAGE = {
    "no out": (["--random-weights"], "--out: expected the bundle's folder, or --dry-run"),
    "dry run of random weights": (["--random-weights", "--dry-run"], "--dry-run: expected --weights FILE"),
    "dry run of nothing": (["--dry-run"], "--dry-run: expected --weights FILE"),
    "nothing can be missing of random weights": (
        ["--random-weights", "--allow-missing", "*", "--out", "{out}"],
        "--allow-missing: expected only with --weights FILE",
    ),
}


@pytest.mark.parametrize("call", USAGE)
def test_options_that_contradict_each_other_are_a_usage_error(tmp_path, capfd, call):
    arguments, words = USAGE[call]
    out = str(tmp_path / "out")
    assert run_app(["export", "--preset", "tiny", *(argument.format(out=out) for argument in arguments)]) == 2
    assert words in capfd.readouterr().err
    assert list(tmp_path.iterdir()) == []


# --- The bundle ---------------------------------------------------------------------------------------------------


def test_an_export_says_in_short_what_it_took(instant_export, detector, drawn_names, tmp_path, capfd):
    arguments = ["export", "--preset", "tiny", "--weights", str(detector), "--allow-missing", "[!i]*"]
    assert run_app([*arguments, "--seed", "3", "--json", "--out", str(tmp_path / "bundle")]) == 0
    printed = capfd.readouterr()
    assert json.loads(printed.out)["bundle"] == str(tmp_path / "bundle")
    assert f"epoch_24.pth: {len(drawn_names)} tensors missing, allowed by [!i]*: drawn from seed 3" in printed.err
    assert "epoch_24.pth: 2 tensors left aside: pts_bbox_head.cls.weight, depth_branch.conv.bias" in printed.err


def test_a_refused_export_names_the_tensors_and_points_to_the_dry_run(detector, tmp_path, capfd):
    assert run_app(["export", "--preset", "tiny", "--weights", str(detector), "--out", str(tmp_path / "bundle")]) == 4
    err = capfd.readouterr().err
    assert "missing: lifter.reduction.weight" in err
    assert "`duospacenet export --dry-run` prints the whole report" in err
    assert list(tmp_path.iterdir()) == []


def test_an_unreadable_checkpoint_has_no_report_to_point_to(detector, tmp_path, capfd):
    (tmp_path / "cut.pth").write_bytes(detector.read_bytes()[:3000])
    for rest in (["--dry-run"], ["--out", str(tmp_path / "bundle")]):
        assert run_app(["export", "--preset", "tiny", "--weights", str(tmp_path / "cut.pth"), *rest]) == 4
        printed = capfd.readouterr()
        assert "cut.pth: expected .safetensors or a weights-only .pth; got 3000 bytes" in printed.err
        assert "--dry-run" not in printed.err
        assert printed.out == ""


def test_the_manifest_records_what_became_of_the_checkpoint(imported, detector, tiny_model, drawn_names):
    weights = read_manifest(imported).weights
    assert weights.source == detector.name
    assert weights.trained is False
    assert weights.checkpoint.layout == "mmdetection3d"
    assert weights.checkpoint.wrappers == ("state_dict",)
    assert weights.checkpoint.matched == sum(name.startswith("image_encoder.") for name in tiny_model.state_dict())
    assert weights.checkpoint.missing == dict.fromkeys(drawn_names, "[!i]*")
    assert weights.checkpoint.seed == 0
    assert weights.checkpoint.left_aside == tuple(HEADS)
    assert [note.split(" the preprocessing")[0] for note in weights.checkpoint.notes] == [
        "the backbone must have been trained with"
    ]


def test_weights_that_are_all_there_have_no_seed_and_may_be_trained(instant_export, tiny_model, tmp_path):
    from duospacenet.weights import save_checkpoint

    save_checkpoint(tmp_path / "tiny.safetensors", tiny_model, {"trained": "true"})
    arguments = ["export", "--preset", "tiny", "--weights", str(tmp_path / "tiny.safetensors")]
    for rest in ([], ["--allow-missing", "decoder.*"]):
        out = tmp_path / f"bundle{len(rest)}"
        assert run_app([*arguments, *rest, "--seed", "5", "--out", str(out)]) == 0
        weights = read_manifest(out).weights
        assert (weights.trained, weights.checkpoint.seed, weights.checkpoint.missing) == (True, None, {})
        assert weights.checkpoint.matched == len(tiny_model.state_dict())


def test_what_is_missing_is_drawn_from_the_seed(imported, tiny_bundle, detector, instant_export, tmp_path):
    """`tiny_model` is drawn from seed 0 as a whole."""
    digests = [read_manifest(imported).weights.sha256, read_manifest(tiny_bundle).weights.sha256]
    for seed in ("0", "1"):
        arguments = ["export", "--preset", "tiny", "--weights", str(detector), "--allow-missing", "[!i]*"]
        assert run_app([*arguments, "--seed", seed, "--out", str(tmp_path / seed)]) == 0
        digests.append(read_manifest(tmp_path / seed).weights.sha256)
    assert digests[0] == digests[1] == digests[2] != digests[3]


def test_inspect_shows_the_record(imported, drawn_names, capfd, monkeypatch):
    monkeypatch.setattr("duospacenet.cli.inspect.results.width", 200)
    assert run_app(["inspect", str(imported)]) == 0
    out = capfd.readouterr().out
    assert "tensors by mmdetection3d's names of an image backbone and neck, inside state_dict" in out
    assert f"{len(drawn_names)} tensors missing, allowed by [!i]*: drawn from seed 0" in out
    assert "2 tensors left aside: pts_bbox_head.cls.weight, depth_branch.conv.bias" in out
    assert run_app(["inspect", str(imported), "--json"]) == 0
    assert json.loads(capfd.readouterr().out)["weights"]["checkpoint"]["missing"][drawn_names[0]] == "[!i]*"


def test_a_bundle_that_was_imported_is_proven_again_with_what_its_manifest_records(imported, detector, capfd):
    """Its graphs are those of the same weights, traced in one piece."""
    again = ["parity", str(imported), "--weights", str(detector), *FRAMES]
    assert run_app(again) == 0
    assert "warning" not in capfd.readouterr().err
    assert run_app([*again, "--seed", "1"]) == 1
    assert "the bundle was made from other weights" in capfd.readouterr().err
    assert run_app([*again, "--allow-missing", "decoder.*"]) == 4
    assert "missing: lifter.reduction.weight" in capfd.readouterr().err
