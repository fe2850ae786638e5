"""Every row of the paper's ablation tables exports to a bundle that passes parity and holds only what it needs."""

import json
import shutil

import pytest

from benchmarks.ablation_tables import ABLATION_TABLES, ablation_presets
from duospacenet.cli.main import run_app
from duospacenet.export import export_bundle
from duospacenet.jobs.golden_check import check_golden_example
from duospacenet.model import PRESETS, DuoSpaceNet, randomise
from duospacenet.runtime import Pipeline
from duospacenet.runtime.bundle.manifest import GRAPH_NAMES, read_manifest
from duospacenet.runtime.errors import ArtifactError, UsageError
from tests.helpers.bundles import edit_manifest
from tests.helpers.exports import share_conversions

ABLATION_PRESETS = [name for name in ablation_presets("tiny") if name != "tiny"]


@pytest.fixture(scope="module")
def exported(tmp_path_factory, tiny_bundle, tiny_model):
    """A function that returns the bundle of a preset, and exports it on its first use.

    Tensors of the same name and shape have the same weights in all rows. So the graphs that a row does not change are
    equal to those of another row and are converted once.
    """
    folder, bundles = tmp_path_factory.mktemp("ablations"), {"tiny": tiny_bundle}
    weights = {(name, tensor.shape): tensor for name, tensor in tiny_model.state_dict().items()}

    def bundle_of(name):
        if name not in bundles:
            model = randomise(DuoSpaceNet(PRESETS[name]))
            state = model.state_dict()
            model.load_state_dict({key: weights.setdefault((key, state[key].shape), state[key]) for key in state})
            bundles[name] = folder / name
            with share_conversions():
                export_bundle(model, bundles[name])
        return bundles[name]

    return bundle_of


def parity_report(bundle):
    return read_manifest(bundle).parity


@pytest.mark.parametrize("row", ABLATION_TABLES["duo space features"])
def test_the_rows_on_duo_space_features_pass_parity(exported, row):
    assert parity_report(exported(f"tiny-{row}")).passed


@pytest.mark.parametrize("row", ABLATION_TABLES["feature divergence enhancement"])
def test_the_rows_on_feature_divergence_enhancement_pass_parity(exported, row):
    assert parity_report(exported(f"tiny-{row}".removesuffix("-"))).passed


@pytest.mark.parametrize("row", ABLATION_TABLES["duo space queries"])
def test_the_rows_on_duo_space_queries_pass_parity(exported, row):
    assert parity_report(exported(f"tiny-{row}".removesuffix("-"))).passed


@pytest.mark.parametrize("row", ABLATION_TABLES["temporal strategies"])
def test_the_rows_on_temporal_strategies_pass_parity_with_a_full_window(exported, row):
    """The stress sequence fills the window, and the decoder depends on every element of every slot."""
    report = parity_report(exported(f"tiny-{row}".removesuffix("-")))
    assert report.passed
    assert max(frame.window for frame in report.stream) == 4
    assert report.elements["decoder"] > 0
    assert report.wrong_elements == ()


@pytest.mark.parametrize("name", ABLATION_PRESETS)
def test_the_golden_example_of_each_row_passes(exported, name):
    assert check_golden_example(exported(name)).passed


@pytest.mark.parametrize("name", ABLATION_PRESETS)
def test_a_bundle_holds_the_graphs_that_its_row_needs(exported, name):
    manifest = read_manifest(exported(name))
    graphs = ("backbone", "decoder") if name == "tiny-pv" else GRAPH_NAMES
    assert sorted(manifest.graphs) == sorted(graphs)
    assert manifest.preset == name


def input_names(bundle, graph):
    return {spec.name for spec in read_manifest(bundle).graphs[graph].inputs}


def test_the_decoder_has_only_the_inputs_that_its_row_uses(exported):
    duo = input_names(exported("tiny"), "decoder")
    assert {"image_T_ego", "slot3.pv_value_1_3", "slot3.bev_value_1"} < duo
    assert input_names(exported("tiny-bev"), "decoder") == {
        *("past_T_now", "time_delta_s", "frame_valid"),
        *(f"slot{slot}.bev_value_{layer}" for slot in range(4) for layer in range(2)),
    }
    assert input_names(exported("tiny-pv"), "decoder") == {name for name in duo if ".bev" not in name}
    stacked = {f"slot{slot}.bev" for slot in range(4)}
    assert input_names(exported("tiny-stacking"), "decoder") == {name for name in duo if ".bev" not in name} | stacked


# --- A bundle without BEV and maps ---------------------------------------------------------------------------------


def test_a_bundle_without_maps_runs_and_refuses_requests_for_maps(exported, frames, tmp_path, capfd):
    bundle = exported("tiny-pv")
    pipeline = Pipeline.load(bundle)
    assert len(pipeline.stream().step(frames[0])) > 0
    with pytest.raises(
        UsageError, match="maps: expected a bundle with map classes; got preset tiny-pv, which has none"
    ):
        pipeline.stream(maps=True)
    source = "synthetic:1:2"
    assert run_app(["run", str(bundle), source, "--out", str(tmp_path / "maps"), "--maps"]) == 2
    assert "got preset tiny-pv, which has none" in capfd.readouterr().err
    assert not (tmp_path / "maps").exists()
    assert run_app(["run", str(bundle), source, "--out", str(tmp_path / "run"), "--draw"]) == 0
    lines = (tmp_path / "run" / "results.jsonl").read_text().splitlines()
    assert [len(json.loads(line)["boxes"]) > 0 for line in lines] == [True, True]


@pytest.mark.parametrize(
    ("name", "missing", "message"),
    [
        ("tiny-pv", "backbone", "expected backbone, always needed"),
        ("tiny-bev", "projector", "expected projector, needed by segmenter"),
        ("tiny-bev", "lifter", "expected lifter, needed by segmenter"),
    ],
)
def test_a_bundle_without_a_graph_that_it_needs_is_refused(exported, tmp_path, name, missing, message):
    bundle = tmp_path / "bundle"
    shutil.copytree(exported(name), bundle)
    edit_manifest(bundle, lambda manifest: manifest["graphs"].pop(missing))
    with pytest.raises(ArtifactError, match=f"field graphs: {message}; it is missing"):
        read_manifest(bundle)
