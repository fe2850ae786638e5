"""Tests of the training record: the provenance that the weights file carries."""

import json
import subprocess
from dataclasses import replace
from pathlib import Path

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


def test_the_weights_of_a_pretraining_run_are_not_marked_as_trained():
    assert record_with(replace(SIX_STEPS, pretraining=True)).metadata(6)["trained"] == "false"
