"""Both forms of attention in a bundle: compact, and static shapes for other engines."""

import shutil
from pathlib import Path

import numpy as np
import onnx
import pytest

from duospacenet import jobs
from duospacenet.cli.main import run_app
from duospacenet.export import check_parity
from duospacenet.runtime import Pipeline
from duospacenet.runtime.bundle.manifest import read_manifest
from tests.faults.catalogue import ONE_FRAME
from tests.helpers.bundles import GRAPHS, edit_manifest
from tests.helpers.parity_results import passing_result
from tests.helpers.streams import detect_all, lose_cameras


def operators(bundle: Path) -> set[str]:
    return {node.op_type for name in GRAPHS for node in onnx.load(bundle / f"{name}.onnx").graph.node}


def test_a_grid_sample_bundle_passes_parity_and_holds_no_operator_with_a_dynamic_shape(portable_bundle, tiny_bundle):
    manifest = read_manifest(portable_bundle)
    assert manifest.attention == "grid-sample"
    assert manifest.parity is not None and manifest.parity.passed
    assert not {"NonZero", "TopK", "Range"} & operators(portable_bundle)
    assert {"NonZero", "TopK", "Range"} < operators(tiny_bundle)
    assert read_manifest(tiny_bundle).attention == "compact"


def test_both_forms_give_the_same_detections(portable_bundle, pipeline, frames):
    lost = [*frames[:2], lose_cameras(frames[2], "CAM_FRONT"), *frames[3:5]]
    one, other = detect_all(Pipeline.load(portable_bundle), lost, maps=True), detect_all(pipeline, lost, maps=True)
    for first, second in zip(one, other, strict=True):
        rows = [dict(zip(zip(d.queries, d.classes, strict=True), range(len(d)), strict=True)) for d in (first, second)]
        common = rows[0].keys() & rows[1].keys()
        # Pairs with almost equal scores may be selected in one form only.
        assert len(common) >= len(first) - 1
        ours, theirs = ([row[pair] for pair in common] for row in rows)
        np.testing.assert_allclose(first.boxes[ours], second.boxes[theirs], atol=1e-4)
        np.testing.assert_allclose(first.scores[ours], second.scores[theirs], atol=1e-4)
        for name, mask in first.maps.items():
            np.testing.assert_allclose(mask, second.maps[name], atol=1e-4)


@pytest.mark.parametrize(("claimed", "actual"), [("compact", "grid-sample"), ("grid-sample", "compact")])
def test_a_manifest_with_the_other_form_fails_parity(
    portable_bundle, tiny_bundle, tiny_model, tmp_path, claimed, actual
):
    bundle = Path(shutil.copytree(portable_bundle if actual == "grid-sample" else tiny_bundle, tmp_path / "bundle"))
    edit_manifest(bundle, lambda manifest: manifest.update(attention=claimed))
    result = check_parity(bundle, tiny_model, stress_frames=ONE_FRAME, random_inputs=0)
    assert [str(difference) for difference in result.manifest] == [
        f"manifest.json: field attention: expected {actual!r}; got {claimed!r}"
    ]
    assert not result.passed


@pytest.mark.parametrize(
    ("options", "form"),
    [
        ([], "compact"),
        (["--attention", "grid-sample"], "grid-sample"),
        (["--attention", "compact"], "compact"),
    ],
)
def test_the_command_passes_the_form_on(tmp_path, monkeypatch, options, form):
    chosen = []

    def export(model, out, weights, progress, dcn, attention, opset):
        chosen.append(attention)
        return passing_result()

    monkeypatch.setattr("duospacenet.export.bundle.export_bundle", export)
    assert run_app(["export", "--preset", "tiny", "--random-weights", *options, "--out", str(tmp_path / "b")]) == 0
    jobs.export_model("tiny", tmp_path / "c", random_weights=True, attention="grid-sample")
    assert chosen == [form, "grid-sample"]


def test_an_unknown_form_is_refused(tmp_path, capfd):
    command = ["export", "--preset", "tiny", "--random-weights", "--attention", "conv", "--out", str(tmp_path / "b")]
    assert run_app(command) == 2
    assert "compact" in capfd.readouterr().err


def test_inspect_names_the_form(portable_bundle, tiny_bundle, capfd):
    for bundle, text in ((tiny_bundle, "only in the cameras that see it"), (portable_bundle, "in every camera")):
        assert run_app(["inspect", str(bundle)]) == 0
        printed = capfd.readouterr().out
        assert text in next(line for line in printed.splitlines() if line.startswith("attention "))
