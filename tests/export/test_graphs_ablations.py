"""Every row of the paper's ablation tables becomes a bundle that is proven equal; what a row has not is not in it."""

import json
import shutil

import pytest

from benchmarks.ablation_tables import ABLATION_TABLES, ablation_presets
from duospacenet.cli.main import run_app
from duospacenet.export import export_bundle
from duospacenet.model import PRESETS, DuoSpaceNet, randomise
from duospacenet.runtime import Pipeline
from duospacenet.runtime.bundle.manifest import GRAPH_NAMES, read_manifest
from duospacenet.runtime.errors import ArtifactError, UsageError
from tests.helpers.bundles import edit_manifest

OTHERS = [name for name in ablation_presets("tiny") if name != "tiny"]


@pytest.fixture(scope="module")
def exported(tmp_path_factory, tiny_bundle):
    """Bundles by preset, exported when they are asked for."""
    folder, bundles = tmp_path_factory.mktemp("ablations"), {"tiny": tiny_bundle}

    def of(name):
        if name not in bundles:
            bundles[name] = folder / name
            export_bundle(randomise(DuoSpaceNet(PRESETS[name])), bundles[name])
        return bundles[name]

    return of


def proof_of(bundle):
    return read_manifest(bundle).parity


@pytest.mark.parametrize("row", ABLATION_TABLES["duo space features"])
def test_table_duo_space_features_passes_parity(exported, row):
    assert proof_of(exported(f"tiny-{row}")).passed


@pytest.mark.parametrize("row", ABLATION_TABLES["feature divergence enhancement"])
def test_table_feature_divergence_enhancement_passes_parity(exported, row):
    assert proof_of(exported(f"tiny-{row}".removesuffix("-"))).passed


@pytest.mark.parametrize("row", ABLATION_TABLES["duo space queries"])
def test_table_duo_space_queries_passes_parity(exported, row):
    assert proof_of(exported(f"tiny-{row}".removesuffix("-"))).passed


@pytest.mark.parametrize("row", ABLATION_TABLES["temporal strategies"])
def test_table_temporal_strategies_passes_parity(exported, row):
    """A history that counts: the scripted drive streams, and every slot of the window is alive."""
    proof = proof_of(exported(f"tiny-{row}".removesuffix("-")))
    assert proof.passed
    assert max(frame.window for frame in proof.stream) == 4
    assert proof.dead_inputs == ()


@pytest.mark.parametrize("name", OTHERS)
def test_a_bundle_holds_the_graphs_that_its_row_needs(exported, name):
    manifest = read_manifest(exported(name))
    graphs = ("backbone", "decoder") if name == "tiny-pv" else GRAPH_NAMES
    assert sorted(manifest.graphs) == sorted(graphs)
    assert manifest.preset == name


def inputs_of(bundle, graph):
    return {spec.name for spec in read_manifest(bundle).graphs[graph].inputs}


def test_the_decoder_asks_only_for_what_it_looks_at(exported):
    duo = inputs_of(exported("tiny"), "decoder")
    assert {"image_T_ego", "slot3.pv_value_1_3", "slot3.bev_value_1"} < duo
    assert inputs_of(exported("tiny-bev"), "decoder") == {
        *("past_T_now", "time_delta_s", "frame_valid"),
        *(f"slot{slot}.bev_value_{layer}" for slot in range(4) for layer in range(2)),
    }
    assert inputs_of(exported("tiny-pv"), "decoder") == {name for name in duo if ".bev" not in name}
    fused = {f"slot{slot}.bev" for slot in range(4)}
    assert inputs_of(exported("tiny-stacking"), "decoder") == {name for name in duo if ".bev" not in name} | fused


# --- A bundle without BEV and maps ---------------------------------------------------------------------------------


def test_a_bundle_without_maps_runs_and_refuses_to_draw_them(exported, frames, tmp_path, capfd):
    bundle = exported("tiny-pv")
    pipeline = Pipeline.load(bundle)
    assert len(pipeline.stream().step(frames[0])) > 0
    with pytest.raises(
        UsageError, match="maps: expected a bundle with map classes; got preset tiny-pv, which has none"
    ):
        pipeline.stream(maps=True)
    drive = "synthetic:1:2"
    assert run_app(["run", str(bundle), drive, "--out", str(tmp_path / "maps"), "--maps"]) == 2
    assert "got preset tiny-pv, which has none" in capfd.readouterr().err
    assert not (tmp_path / "maps").exists()
    assert run_app(["run", str(bundle), drive, "--out", str(tmp_path / "run"), "--draw"]) == 0
    lines = (tmp_path / "run" / "results.jsonl").read_text().splitlines()
    assert [len(json.loads(line)["boxes"]) > 0 for line in lines] == [True, True]


@pytest.mark.parametrize(
    ("name", "lacking", "words"),
    [
        ("tiny-pv", "backbone", "expected backbone, always"),
        ("tiny-bev", "projector", "expected projector, needed by segmenter"),
        ("tiny-bev", "lifter", "expected lifter, needed by segmenter"),
    ],
)
def test_a_bundle_that_lacks_a_graph_it_needs_is_refused(exported, tmp_path, name, lacking, words):
    bundle = tmp_path / "bundle"
    shutil.copytree(exported(name), bundle)
    edit_manifest(bundle, lambda manifest: manifest["graphs"].pop(lacking))
    with pytest.raises(ArtifactError, match=f"field graphs: {words}; it is missing"):
        read_manifest(bundle)
