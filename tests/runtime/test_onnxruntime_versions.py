"""Bundles in the oldest and the newest onnxruntime that `pyproject.toml` allows, compared with their golden examples.

The golden values come from PyTorch in eager mode.
"""

import json
from dataclasses import replace
from pathlib import Path

import pytest
from packaging.version import Version

from duospacenet.export import export_bundle
from duospacenet.model import PRESETS, DuoSpaceNet, randomise
from duospacenet.model.config import ResNetConfig
from tests.helpers.bundles import edit_graph
from tests.helpers.exports import share_conversions
from tests.helpers.onnxruntime_versions import VERSIONS, lower_bound, run_with_onnxruntime

# The smallest model with the operator DeformConv. Its bundle has the newest operator set.
DEFORMABLE = replace(
    PRESETS["tiny-pv"],
    preset="tiny-pv-dcn",
    backbone=ResNetConfig("bottleneck", (1, 1, 1, 1), width=8, deformable_stages=(3, 4)),
    num_layers=1,
    num_frames=1,
    num_cameras=1,
)


@pytest.fixture(scope="module")
def bundles(tiny_bundle, portable_bundle, tiny_int8_bundle, tmp_path_factory) -> dict[str, Path]:
    deformable = tmp_path_factory.mktemp("bundles") / "deformable"
    with share_conversions():
        export_bundle(randomise(DuoSpaceNet(DEFORMABLE)).eval(), deformable, opset=22)
    return {
        "compact": tiny_bundle,
        "grid-sample": portable_bundle,
        "int8": tiny_int8_bundle,
        "DeformConv": deformable,
    }


@pytest.mark.parametrize("version", VERSIONS)
@pytest.mark.parametrize("form", ["compact", "grid-sample", "int8", "DeformConv"])
def test_a_bundle_gives_its_golden_results_in_the_oldest_and_the_newest_onnxruntime(bundles, form, version):
    done = run_with_onnxruntime(version, "inspect", bundles[form], "--verify", "--json")
    assert done.returncode == 0, done.stderr + done.stdout
    check = json.loads(done.stdout)
    assert check["passed"] and check["values"] > 1000
    found = Version(check["engine"]["version"])
    assert found == Version(lower_bound()) if version == "oldest" else found >= Version(lower_bound())


@pytest.mark.parametrize("version", VERSIONS)
def test_a_wrong_attribute_is_found_in_both(copied_bundle, version):
    """So the check above can fail."""

    def round_to_the_nearest(model):
        for node in model.graph.node:
            for attribute in node.attribute:
                if node.op_type == "GridSample" and attribute.name == "mode":
                    attribute.s = b"nearest"

    edit_graph(copied_bundle, "lifter", round_to_the_nearest)
    done = run_with_onnxruntime(version, "inspect", copied_bundle, "--verify", "--json")
    assert done.returncode == 1, done.stderr
    assert "lifter" in json.loads(done.stdout)["difference"]
