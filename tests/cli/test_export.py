"""`duospacenet export`: the dry run, tensors that a checkpoint lacks, and what the bundle records."""

import json
from hashlib import sha256
from pathlib import Path

import pytest
import torch

from duospacenet.cli.main import run_app
from duospacenet.export import bundle
from duospacenet.runtime.bundle.manifest import read_manifest
from duospacenet.weights import save_checkpoint
from tests.helpers.checkpoints import in_mmdetection3d_names, write
from tests.helpers.parity_results import passing_result

IMAGENET = Path(__file__).resolve().parents[2] / "../shared/data/resnet50_imagenet/resnet50_caffe_imagenet.safetensors"
DRY_RUN = ["export", "--preset", "tiny", "--dry-run", "--weights"]
HEADS = {"pts_bbox_head.cls.weight": torch.zeros(3), "depth_branch.conv.bias": torch.zeros(3)}
FRAMES = ["--source", "synthetic:3:2"]


@pytest.fixture(scope="module")
def detector(tiny_model, tmp_path_factory) -> Path:
    """An mmdetection3d checkpoint with the image encoder of `tiny_model`; all weights of that come from seed 0."""
    named = in_mmdetection3d_names(tiny_model.state_dict())
    path = tmp_path_factory.mktemp("weights") / "epoch_24.pth"
    return write(path, {"state_dict": named | HEADS, "meta": {"epoch": 24}})


@pytest.fixture(scope="module")
def missing_names(tiny_model) -> list[str]:
    """The tensors that the detector lacks, without the counters of batch norms."""
    return [
        name
        for name in tiny_model.state_dict()
        if not name.startswith("image_encoder.") and not name.endswith("num_batches_tracked")
    ]


@pytest.fixture
def instant_export(reuse_traced_graphs, monkeypatch):
    """Exports copy the graphs of `tiny_bundle` and skip the parity check: the tests here only look at the manifest."""
    passed = passing_result()
    monkeypatch.setattr(bundle, "check_parity", lambda *_, **__: passed)


@pytest.fixture
def imported(instant_export, detector, tmp_path) -> Path:
    """A bundle with the detector's weights and random weights for all else."""
    arguments = ["export", "--preset", "tiny", "--weights", str(detector), "--allow-missing", "[!i]*"]
    assert run_app([*arguments, "--out", str(tmp_path / "bundle")]) == 0
    return tmp_path / "bundle"


@pytest.fixture(scope="module")
def checkpoint(tiny_model, tmp_path_factory) -> Path:
    """The weights of `tiny_model` in this toolkit's own layout."""
    path = tmp_path_factory.mktemp("weights") / "tiny.safetensors"
    save_checkpoint(path, tiny_model)
    return path


@pytest.fixture(scope="module")
def exported(checkpoint, tmp_path_factory) -> Path:
    """A bundle that the command line exported from `checkpoint`, all graphs traced."""
    out = tmp_path_factory.mktemp("exported") / "bundle"
    assert run_app(["export", "--preset", "tiny", "--weights", str(checkpoint), "--out", str(out)]) == 0
    return out


# --- The dry run --------------------------------------------------------------------------------------------------


def test_a_dry_run_prints_the_missing_tensors_ends_with_4_and_writes_nothing(detector, missing_names, tmp_path, capfd):
    before = sorted(detector.parent.iterdir())
    assert run_app([*DRY_RUN, str(detector)]) == 4
    out = " ".join(capfd.readouterr().out.split())
    assert "epoch_24.pth: mmdetection3d's names of an image backbone and neck, inside state_dict" in out
    assert f"refused: {len(missing_names)} missing: lifter.reduction.weight" in out
    assert "--allow-missing 'lifter.*'" in out
    assert "must have been trained with the preprocessing" in out
    assert "ReLU" not in out
    assert sorted(detector.parent.iterdir()) == before


def test_a_dry_run_of_an_accepted_checkpoint_ends_with_0(detector, missing_names, tiny_model, capfd):
    assert run_app([*DRY_RUN, str(detector), "--allow-missing", "[!i]*"]) == 0
    printed = capfd.readouterr()
    num_matched = sum(name.startswith("image_encoder.") for name in tiny_model.state_dict())
    assert f"accepted: {num_matched} tensors matched, {len(missing_names)} allowed to be missing" in printed.out
    assert printed.err == ""


def test_a_dry_run_as_json_lists_every_name(detector, missing_names, capfd):
    patterns = ["--allow-missing", "decoder.*", "--allow-missing", "nothing.*"]
    assert run_app([*DRY_RUN, str(detector), *patterns, "--json"]) == 4
    printed = capfd.readouterr()
    report = json.loads(printed.out)
    assert report["checkpoint"] == "epoch_24.pth"
    assert report["accepted"] is False
    assert report["layout"] == "mmdetection3d"
    assert report["wrappers"] == ["state_dict"]
    assert report["missing"] == [name for name in missing_names if not name.startswith("decoder.")]
    assert report["allowed_missing"] == {name: "decoder.*" for name in missing_names if name.startswith("decoder.")}
    assert report["left_aside"] == list(HEADS)
    assert report["matched"]["image_encoder.neck.lateral.1.bias"] == "img_neck.lateral_convs.1.conv.bias"
    assert len([note for note in report["notes"] if "pattern nothing.* matches no missing tensor" in note]) == 1
    assert printed.err == ""


def test_a_dry_run_lists_all_faults_in_a_table(tiny_model, tmp_path, capfd, monkeypatch):
    monkeypatch.setenv("COLUMNS", "160")
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
        ["ignored", "0", ""],
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
    "no out": (["--random-weights"], "--out: expected a folder for the bundle, or --dry-run"),
    "dry run of random weights": (["--random-weights", "--dry-run"], "--dry-run: expected --weights FILE"),
    "dry run of nothing": (["--dry-run"], "--dry-run: expected --weights FILE"),
    "random weights lack no tensors": (
        ["--random-weights", "--allow-missing", "*", "--out", "{out}"],
        "--allow-missing: expected only with --weights FILE",
    ),
}


@pytest.mark.parametrize("call", USAGE)
def test_options_that_contradict_each_other_are_refused(tmp_path, capfd, call):
    arguments, words = USAGE[call]
    out = str(tmp_path / "out")
    assert run_app(["export", "--preset", "tiny", *(argument.format(out=out) for argument in arguments)]) == 2
    assert words in capfd.readouterr().err
    assert list(tmp_path.iterdir()) == []


# --- The bundle ---------------------------------------------------------------------------------------------------


def test_a_checkpoint_is_exported_with_its_provenance(exported, tiny_bundle, checkpoint):
    manifest = json.loads((exported / "manifest.json").read_text())
    assert manifest["weights"]["source"] == "tiny.safetensors"
    assert manifest["weights"]["file_sha256"] == sha256(checkpoint.read_bytes()).hexdigest()
    assert manifest["weights"]["sha256"] == json.loads((tiny_bundle / "manifest.json").read_text())["weights"]["sha256"]
    assert manifest["weights"]["trained"] is None
    assert manifest["parity"]["passed"] is True


def test_the_same_weights_give_the_same_bytes_in_two_exports(exported, tiny_bundle):
    """One from a model in memory, the other from its checkpoint: only the provenance differs."""
    for graph in ("projector", "backbone", "lifter", "decoder", "segmenter"):
        assert (exported / f"{graph}.onnx").read_bytes() == (tiny_bundle / f"{graph}.onnx").read_bytes()
    one, other = (json.loads((bundle / "manifest.json").read_text()) for bundle in (exported, tiny_bundle))
    differing = {"weights": None, "sha256": None}
    assert one | differing == other | differing


def test_an_export_summarises_the_checkpoint_on_stderr(instant_export, detector, missing_names, tmp_path, capfd):
    arguments = ["export", "--preset", "tiny", "--weights", str(detector), "--allow-missing", "[!i]*"]
    assert run_app([*arguments, "--seed", "3", "--json", "--out", str(tmp_path / "bundle")]) == 0
    printed = capfd.readouterr()
    assert json.loads(printed.out)["bundle"] == str(tmp_path / "bundle")
    assert (
        f"epoch_24.pth: {len(missing_names)} missing tensors, allowed by [!i]*: randomly initialised from seed 3"
        in printed.err
    )
    assert "epoch_24.pth: 2 tensors ignored: pts_bbox_head.cls.weight, depth_branch.conv.bias" in printed.err


def test_a_refused_export_names_the_tensors_and_points_to_the_dry_run(detector, tmp_path, capfd):
    assert run_app(["export", "--preset", "tiny", "--weights", str(detector), "--out", str(tmp_path / "bundle")]) == 4
    err = capfd.readouterr().err
    assert "missing: lifter.reduction.weight" in err
    assert "`duospacenet export --dry-run` prints the whole report" in err
    assert list(tmp_path.iterdir()) == []


def test_an_unreadable_checkpoint_is_refused_without_a_hint_to_the_dry_run(detector, tmp_path, capfd):
    (tmp_path / "cut.pth").write_bytes(detector.read_bytes()[:3000])
    for rest in (["--dry-run"], ["--out", str(tmp_path / "bundle")]):
        assert run_app(["export", "--preset", "tiny", "--weights", str(tmp_path / "cut.pth"), *rest]) == 4
        printed = capfd.readouterr()
        assert "cut.pth: expected .safetensors or a weights-only .pth; got 3000 bytes" in printed.err
        assert "--dry-run" not in printed.err
        assert printed.out == ""


def test_the_manifest_records_how_the_checkpoint_fitted(imported, detector, tiny_model, missing_names):
    weights = read_manifest(imported).weights
    assert weights.source == detector.name
    assert weights.trained is False
    assert weights.checkpoint.layout == "mmdetection3d"
    assert weights.checkpoint.wrappers == ("state_dict",)
    assert weights.checkpoint.matched == sum(name.startswith("image_encoder.") for name in tiny_model.state_dict())
    assert weights.checkpoint.missing == dict.fromkeys(missing_names, "[!i]*")
    assert weights.checkpoint.seed == 0
    assert weights.checkpoint.left_aside == tuple(HEADS)
    assert [note.split(" the preprocessing")[0] for note in weights.checkpoint.notes] == [
        "the backbone must have been trained with"
    ]


OTHER_NECK = {"img_neck.lateral_convs.0.conv.weight": torch.zeros(32, 7, 1, 1), "img_neck.x.weight": torch.zeros(3)}


def test_left_out_tensors_and_the_chosen_copy_are_recorded_and_must_be_given_to_parity_again(
    instant_export, tiny_model, missing_names, tmp_path, capfd, monkeypatch
):
    named = in_mmdetection3d_names(tiny_model.state_dict())
    backbone = {name: named[name] for name in named if name.startswith("img_backbone.")}
    path = write(tmp_path / "w.pth", {"teacher": backbone | OTHER_NECK, "student": named})
    choice = ["--weights-key", "teacher", "--allow-missing", "*"]
    arguments = ["export", "--preset", "tiny", "--weights", str(path), "--ignore", "img_neck.*", "--seed", "3"]
    assert run_app([*arguments, *choice, "--json", "--out", str(tmp_path / "bundle")]) == 0
    assert "w.pth: 2 tensors of the file left out, by --ignore img_neck.*" in capfd.readouterr().err
    record = read_manifest(tmp_path / "bundle").weights.checkpoint
    assert record.ignored == dict.fromkeys(OTHER_NECK, "img_neck.*")
    assert (record.weights_key, record.wrappers, record.seed) == ("teacher", ("teacher",), 3)
    assert len(record.missing) == len(missing_names) + 14  # seven convolutions of the neck
    monkeypatch.setattr("duospacenet.export.check_parity", lambda *_, **__: passing_result())
    parity = ["parity", str(tmp_path / "bundle"), "--weights", str(path)]
    assert run_app([*parity, "--weights-key", "teacher", "--ignore", "img_neck.*"]) == 0
    assert "warning" not in capfd.readouterr().err
    assert run_app(parity) == 4
    err = capfd.readouterr().err
    assert "the bundle was exported with --ignore 'img_neck.*': give it again" in err
    assert "the bundle was exported with --weights-key teacher: give it again" in err


def test_a_dry_run_lists_left_out_tensors_and_copies_to_choose_from(tiny_model, tmp_path, capfd, monkeypatch):
    monkeypatch.setenv("COLUMNS", "160")
    tensors = tiny_model.state_dict() | {"depth_head.weight": torch.zeros(3)}
    shifted = {name: tensor + 1 for name, tensor in tensors.items()}
    arguments = [*DRY_RUN, str(write(tmp_path / "w.pth", {"student": shifted, "teacher": tensors}))]
    assert run_app(arguments) == 4
    assert "got 2: student, teacher. Choose one, for example with --weights-key student" in capfd.readouterr().err
    assert run_app([*arguments, "--weights-key", "teacher"]) == 4
    assert "Tensors of the file can be left out: --ignore 'depth_head.*'." in capfd.readouterr().out
    assert run_app([*arguments, "--weights-key", "teacher", "--ignore", "depth_head.*"]) == 0
    rows = [[cell.strip() for cell in line.split("│")[1:4]] for line in capfd.readouterr().out.splitlines()]
    assert ["left out, --ignore", "1", "depth_head.weight"] in rows
    assert run_app([*arguments, "--weights-key", "teacher", "--ignore", "depth_head.*", "--json"]) == 0
    assert json.loads(capfd.readouterr().out)["ignored"] == {"depth_head.weight": "depth_head.*"}


def test_a_sharded_checkpoint_is_exported_with_the_hash_of_all_files(instant_export, tiny_model, tmp_path, capfd):
    folder, tensors = tmp_path / "sharded", tiny_model.state_dict()
    folder.mkdir()
    weight_map = {name: f"model-0000{1 + index % 2}-of-00002.safetensors" for index, name in enumerate(tensors)}
    for shard in set(weight_map.values()):
        write(folder / shard, {name: tensors[name] for name in tensors if weight_map[name] == shard})
    (folder / "model.safetensors.index.json").write_text(json.dumps({"weight_map": weight_map}))
    assert run_app([*DRY_RUN, str(folder), "--json"]) == 0
    printed = capfd.readouterr()
    assert len(json.loads(printed.out)["matched"]) == len(tensors)
    assert "reading 2 shards" in printed.err
    arguments = ["export", "--preset", "tiny", "--weights", str(folder), "--out", str(tmp_path / "bundle")]
    assert run_app(arguments) == 0
    weights = read_manifest(tmp_path / "bundle").weights
    lines = [f"{sha256(path.read_bytes()).hexdigest()}  {path.name}\n" for path in sorted(folder.iterdir())]
    assert weights.source == "model.safetensors.index.json"
    assert weights.file_sha256 == sha256("".join(lines).encode()).hexdigest()


def test_complete_weights_have_no_seed_and_may_be_trained(instant_export, tiny_model, tmp_path):
    save_checkpoint(tmp_path / "tiny.safetensors", tiny_model, {"trained": "true"})
    arguments = ["export", "--preset", "tiny", "--weights", str(tmp_path / "tiny.safetensors")]
    for rest in ([], ["--allow-missing", "decoder.*"]):
        out = tmp_path / f"bundle{len(rest)}"
        assert run_app([*arguments, *rest, "--seed", "5", "--out", str(out)]) == 0
        weights = read_manifest(out).weights
        assert (weights.trained, weights.checkpoint.seed, weights.checkpoint.missing) == (True, None, {})
        assert weights.checkpoint.matched == len(tiny_model.state_dict())


def test_missing_tensors_are_initialised_from_the_seed(imported, tiny_bundle, detector, instant_export, tmp_path):
    """All weights of `tiny_model` come from seed 0."""
    digests = [read_manifest(imported).weights.sha256, read_manifest(tiny_bundle).weights.sha256]
    for seed in ("0", "1"):
        arguments = ["export", "--preset", "tiny", "--weights", str(detector), "--allow-missing", "[!i]*"]
        assert run_app([*arguments, "--seed", seed, "--out", str(tmp_path / seed)]) == 0
        digests.append(read_manifest(tmp_path / seed).weights.sha256)
    assert digests[0] == digests[1] == digests[2] != digests[3]


def test_inspect_prints_the_record(imported, missing_names, capfd, monkeypatch):
    monkeypatch.setenv("COLUMNS", "200")
    assert run_app(["inspect", str(imported)]) == 0
    out = capfd.readouterr().out
    assert "tensors with mmdetection3d's names of an image backbone and neck, inside state_dict" in out
    assert f"{len(missing_names)} missing tensors, allowed by [!i]*: randomly initialised from seed 0" in out
    assert "2 tensors ignored: pts_bbox_head.cls.weight, depth_branch.conv.bias" in out
    assert run_app(["inspect", str(imported), "--json"]) == 0
    assert json.loads(capfd.readouterr().out)["weights"]["checkpoint"]["missing"][missing_names[0]] == "[!i]*"


def test_parity_of_an_imported_bundle_uses_the_options_in_its_manifest(imported, detector, capfd):
    """The graphs are those of `tiny_bundle`, whose weights are the same."""
    again = ["parity", str(imported), "--weights", str(detector), "--no-retrace", *FRAMES]
    assert run_app(again) == 0
    assert "warning" not in capfd.readouterr().err
    assert run_app([*again, "--seed", "1"]) == 1
    assert "the bundle was made from other weights" in capfd.readouterr().err
    assert run_app([*again, "--allow-missing", "decoder.*"]) == 4
    assert "missing: lifter.reduction.weight" in capfd.readouterr().err
