"""Choosing a model: where its configuration and its weights come from, and what is refused."""

import json
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from duospacenet.data.anchors_file import Anchors
from duospacenet.jobs.config_file import config_to_toml
from duospacenet.jobs.models import (
    build_model,
    bundle_config,
    choose_config,
    find_preset,
    preset_or_config,
    random_init_options,
    recorded_selection,
    report_checkpoint_fit,
)
from duospacenet.model import PRESETS, DuoSpaceNet, randomise
from duospacenet.runtime.bundle.manifest import CheckpointRecord, read_manifest
from duospacenet.runtime.errors import ArtifactError, InputError, UsageError
from duospacenet.weights import save_checkpoint

TINY = PRESETS["tiny"]
MINE = replace(TINY, preset="mine", num_queries=24)


@pytest.fixture(scope="module")
def model() -> DuoSpaceNet:
    return randomise(DuoSpaceNet(MINE), seed=3)


@pytest.fixture(scope="module")
def config_file(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("configs") / "mine.toml"
    path.write_text(config_to_toml(MINE))
    return path


def checkpoint(folder: Path, model: DuoSpaceNet, config: object = None) -> Path:
    """Weights in a file; its metadata has a configuration unless that is None."""
    metadata = {} if config is None else {"config": json.dumps(config)}
    save_checkpoint(folder / "weights.safetensors", model, metadata)
    return folder / "weights.safetensors"


# --- the configuration --------------------------------------------------------------------------------------------


def test_a_preset_is_found_by_its_name():
    assert choose_config("tiny-pv") == PRESETS["tiny-pv"]


def test_a_configuration_is_read_from_a_file(config_file):
    assert choose_config(None, config_file) == MINE


def test_the_configuration_in_the_weights_is_used_if_no_other_is_given(tmp_path, model, config_file):
    weights = checkpoint(tmp_path, model, MINE.to_dict())
    assert choose_config(None, None, weights) == MINE
    assert choose_config("tiny", None, weights) == TINY


@pytest.mark.parametrize("weights", [None, Path("mine.pth")])
def test_a_preset_and_a_file_together_are_refused(config_file, weights):
    with pytest.raises(UsageError, match="expected either --preset or --config; got both"):
        choose_config("tiny", config_file, weights)


def test_no_configuration_at_all_is_refused(tmp_path, model):
    with pytest.raises(UsageError, match=r"expected --preset NAME or --config FILE; got neither\."):
        choose_config(None)
    weights = checkpoint(tmp_path, model)
    with pytest.raises(UsageError, match=r"got neither, and .*weights\.safetensors contains no configuration"):
        choose_config(None, None, weights)


@pytest.mark.parametrize(
    ("config", "message"),
    [
        ([1], "it is a JSON list"),
        ({"preset": "mine"}, "the configuration in its metadata: field image is missing"),
        (MINE.to_dict() | {"num_heads": 0}, "field num_heads: Input should be greater than 0; got 0"),
        (MINE.to_dict() | {"relu_before_extra_level": True}, "field relu_before_extra_level: expected false; got true"),
    ],
)
def test_a_wrong_configuration_in_the_weights_is_refused(tmp_path, model, config, message):
    weights = checkpoint(tmp_path, model, config)
    with pytest.raises(ArtifactError, match=message) as error:
        choose_config(None, None, weights)
    assert "--preset or --config" in str(error.value)


def test_weights_that_cannot_be_read_are_refused(tmp_path):
    with pytest.raises(ArtifactError, match=r"none\.safetensors"):
        choose_config(None, None, tmp_path / "none.safetensors")
    (tmp_path / "bad.safetensors").write_bytes(b"bad")
    with pytest.raises(ArtifactError, match=r"bad\.safetensors"):
        choose_config(None, None, tmp_path / "bad.safetensors")


def test_a_wrong_configuration_file_is_bad_input(tmp_path):
    (tmp_path / "mine.json").write_text("{}")
    with pytest.raises(InputError, match=r"mine\.json: field preset is missing"):
        choose_config(None, tmp_path / "mine.json")


def test_an_unknown_preset_is_refused_with_the_known_names():
    with pytest.raises(UsageError, match=r"expected one of tiny, nano, small, base, large; or .* -pv.*; got 'smal'"):
        find_preset("smal")


def test_a_bundle_of_another_configuration_version_is_refused(tiny_bundle):
    manifest = read_manifest(tiny_bundle)
    assert bundle_config(tiny_bundle, manifest) == TINY
    newer = manifest.model_copy(update={"config": manifest.config | {"num_experts": 8}})
    with pytest.raises(ArtifactError, match=r"manifest\.json: field config\.num_experts is unknown.*export it again"):
        bundle_config(tiny_bundle, newer)


def test_a_bundle_whose_model_had_a_relu_before_the_fourth_level_has_no_model_here(tiny_bundle):
    manifest = read_manifest(tiny_bundle)
    without, with_relu = (
        manifest.model_copy(update={"config": manifest.config | {"relu_before_extra_level": value}})
        for value in (False, True)
    )
    assert bundle_config(tiny_bundle, without) == TINY
    with pytest.raises(ArtifactError, match=r"field config\.relu_before_extra_level: expected false; got true.*again"):
        bundle_config(tiny_bundle, with_relu)


# --- the weights --------------------------------------------------------------------------------------------------


def test_a_model_is_built_with_the_weights_of_a_checkpoint(tmp_path, model):
    built, record = build_model(MINE, checkpoint(tmp_path, model), random_weights=False, seed=0)
    assert all(bool((built.state_dict()[name] == tensor).all()) for name, tensor in model.state_dict().items())
    assert record.source == "weights.safetensors"


def test_the_same_seed_gives_the_same_random_weights():
    records = [build_model(MINE, None, random_weights=True, seed=seed)[1] for seed in (1, 1, 2)]
    assert records[0] == records[1]
    assert records[0].sha256 != records[2].sha256


@pytest.mark.parametrize(
    ("weights", "random_weights", "got"), [(None, False, "neither"), (Path("m.pth"), True, "both")]
)
def test_weights_from_a_file_and_random_weights_exclude_each_other(weights, random_weights, got):
    with pytest.raises(UsageError, match=f"expected either --weights FILE or --random-weights; got {got}"):
        build_model(MINE, weights, random_weights, seed=0)


def test_missing_tensors_cannot_be_allowed_for_random_weights():
    with pytest.raises(UsageError, match="--allow-missing: expected only with --weights FILE"):
        build_model(MINE, None, random_weights=True, seed=0, allow_missing=["decoder.*"])


@pytest.mark.parametrize("options", [{"ignore": ["a.*"]}, {"weights_key": "model"}])
def test_tensors_of_a_checkpoint_cannot_be_selected_for_random_weights(options):
    (name,) = options
    with pytest.raises(UsageError, match=f"--{name.replace('_', '-')}: expected only with --weights FILE"):
        build_model(MINE, None, random_weights=True, seed=0, **options)


def test_the_record_repeats_the_selection_of_an_export(tmp_path, model):
    """The file has a student and a teacher, and heads for other classes."""
    tensors = model.state_dict()
    heads = {name: torch.zeros(3) for name in tensors if ".heads.classes." in name}
    student = {name: tensor + 1 for name, tensor in tensors.items()}
    path = tmp_path / "distilled.pth"
    torch.save({"student": student, "teacher": {"net": tensors | heads}}, path)
    pattern = "decoder.*.heads.classes.*"
    built, record = build_model(
        MINE, path, False, 3, allow_missing=[pattern], ignore=[pattern, "a.*"], weights_key="teacher"
    )
    assert bool((built.state_dict()["queries.pose"] == tensors["queries.pose"]).all())
    assert record.checkpoint.wrappers == ("teacher", "net")
    assert record.checkpoint.weights_key == "teacher"
    assert record.checkpoint.ignored == dict.fromkeys(heads, pattern)
    assert record.checkpoint.missing == dict.fromkeys(heads, pattern)
    seed, allowed = random_init_options(record.checkpoint)
    _, again = build_model(MINE, path, False, seed, allowed, **recorded_selection(record.checkpoint))
    assert again.sha256 == record.sha256
    assert build_model(MINE, path, False, seed, ["*"], weights_key="student", ignore=["x"])[1].sha256 != record.sha256


def test_a_preset_may_be_given_by_its_name():
    assert preset_or_config("tiny") is PRESETS["tiny"]
    assert preset_or_config(MINE) is MINE
    with pytest.raises(UsageError, match="expected one of tiny, nano, small, base, large"):
        preset_or_config("huge")
    with pytest.raises(UsageError, match="config: expected a preset's name or a DuoSpaceNetConfig; got dict"):
        preset_or_config({"preset": "tiny"})


def test_anchors_do_not_overwrite_trained_query_positions(tmp_path, model, anchors_file):
    with pytest.raises(UsageError, match=r"expected weights without queries\.pose; weights\.safetensors contains"):
        build_model(MINE, checkpoint(tmp_path, model), False, seed=0, anchors=anchors_file(24))


def test_anchors_of_another_number_of_queries_are_refused(anchors_file):
    with pytest.raises(ArtifactError, match=r"expected 24 anchors, one per query of mine; got 20.*--queries 24"):
        build_model(MINE, None, True, seed=0, anchors=anchors_file(20))


def test_anchors_are_recorded_with_the_weights(anchors_file):
    path = anchors_file(24)
    _, record = build_model(MINE, None, True, seed=0, anchors=path)
    assert record.anchors is not None
    assert record.anchors.file == path.name


@pytest.fixture
def anchors_file(tmp_path):
    """A function that writes a file with so many anchors."""

    def write(number: int) -> Path:
        centres = [[float(index), 0.0, 0.0] for index in range(number)]
        record = Anchors(
            schema_version=1,
            centres_m=centres,
            source="synthetic:1:1",
            num_frames=1,
            num_boxes=number,
            range_m=51.2,
            seed=0,
        )
        (tmp_path / "anchors.json").write_text(record.model_dump_json())
        return tmp_path / "anchors.json"

    return write


def test_the_fit_of_a_checkpoint_is_reported_without_loading_it(tmp_path, model):
    path = checkpoint(tmp_path, model)
    assert report_checkpoint_fit(MINE, path, None).accepted
    report = report_checkpoint_fit(TINY, path, None)
    assert not report.accepted
    with pytest.raises(ArtifactError, match=r"none\.pth"):
        report_checkpoint_fit(MINE, tmp_path / "none.pth", None)


def test_a_checkpoint_that_does_not_fit_is_refused_with_the_way_to_the_whole_report(tmp_path, model):
    with pytest.raises(ArtifactError, match="`duospacenet export --dry-run` prints the whole report"):
        build_model(TINY, checkpoint(tmp_path, model), False, seed=0)


RECORD = CheckpointRecord(
    layout="own",
    wrappers=[],
    matched=10,
    missing={"decoder.a": "decoder.*", "decoder.b": "decoder.*", "queries.pose": "queries.pose"},
    seed=5,
    left_aside=[],
    notes=[],
)


@pytest.mark.parametrize(
    ("recorded", "given", "expected"),
    [
        (None, (None, None), (0, [])),
        (None, (3, ["decoder.*"]), (3, ["decoder.*"])),
        (RECORD, (None, None), (5, ["decoder.*", "queries.pose"])),
        (RECORD, (0, ["lifter.*"]), (0, ["lifter.*"])),
        (RECORD.model_copy(update={"missing": {}, "seed": None}), (None, None), (0, [])),
    ],
)
def test_given_random_initialisation_options_override_the_recorded_ones(recorded, given, expected):
    assert random_init_options(recorded, *given) == expected
