"""Tests of the training record: the provenance that the weights file carries."""

import json
import subprocess
from dataclasses import replace
from pathlib import Path

import pytest
from safetensors import safe_open

from tests.helpers.trainings import SIX_STEPS, record_with


def test_the_weights_file_carries_its_provenance(finished):
    with safe_open(finished.path / "weights.safetensors", "pt") as file:
        metadata = file.metadata()
    expected = {"trained": "true", "preset": "tiny", "step": "6", "steps": "6", "seed": "0", "data": "fixed clips"}
    assert expected.items() <= metadata.items()
    assert metadata["start"] == "random"
    assert json.loads(metadata["settings"])["grid_mask"] == 0.5
    provenance = record_with().metadata(6)
    assert {name: metadata[name] for name in provenance} | {"commit": provenance["commit"]} == provenance


def test_the_provenance_names_the_commit_of_the_toolkit():
    root = Path(__file__).parents[2]
    result = subprocess.run(["git", "rev-parse", "HEAD"], cwd=root, capture_output=True, text=True, check=False)
    assert record_with().metadata(6)["commit"] == (result.stdout.strip() if (root / ".git").exists() else "unknown")


PARTS = ("image_encoder", "lifter", "divergence_enhancement", "queries", "decoder", "segmentation")


@pytest.mark.parametrize(
    ("changes", "untrained"),
    [
        ({"pretraining": True}, "lifter, divergence_enhancement, queries, decoder, segmentation"),
        ({"tasks": "detection"}, "segmentation"),
        ({"tasks": "maps"}, "queries, decoder"),
    ],
)
def test_the_weights_file_names_the_parts_that_are_not_trained(changes, untrained):
    """Unless they were trained before."""
    record = record_with(replace(SIX_STEPS, **changes))
    assert {"trained": "false", "untrained": untrained}.items() <= record.metadata(6).items()
    again = replace(record, trained_before=dict.fromkeys(PARTS, True)).metadata(6)
    assert again["trained"] == "true"
    assert "untrained" not in again


def test_the_weights_file_says_if_the_queries_have_no_anchors():
    """A training of the maps alone, from random weights. A pretraining places the queries at anchors."""
    maps = record_with(replace(SIX_STEPS, tasks="maps"))
    assert maps.metadata(6)["anchors"] == "false"
    for trained in (True, None):
        assert "anchors" not in replace(maps, trained_before=dict.fromkeys(PARTS, trained)).metadata(6)
    assert "anchors" not in record_with(replace(SIX_STEPS, pretraining=True)).metadata(6)
