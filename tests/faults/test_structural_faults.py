"""Structural faults in a bundle, sampled by seed, are caught by the `parity` command alone."""

import pytest

from tests.faults import compound_faults
from tests.faults.parity_command import Verdict, judge
from tests.faults.structural_faults import KINDS, structural_fault
from tests.helpers.bundles import edit_manifest

SEEDS = range(1000, 1005)


@pytest.fixture
def bundle(copied_bundle):
    """A bundle as `export --random-weights` writes it."""
    return edit_manifest(copied_bundle, lambda manifest: manifest["weights"].update(trained=False))


def test_a_bundle_without_a_fault_passes(bundle, tmp_path):
    assert judge(bundle, lambda bundle: None, tmp_path / "copy") == Verdict(0, ())


@pytest.mark.parametrize("seed", SEEDS)
def test_a_structural_fault_is_caught(bundle, tmp_path, seed):
    fault = structural_fault(seed, bundle)
    verdict = judge(bundle, fault.inject, tmp_path / "copy")
    assert verdict.is_caught_without_new_export, fault.name


def test_wrong_masks_motion_and_classes_together_are_caught_and_named(bundle, tmp_path):
    failures = judge(bundle, compound_faults.masks_motion_and_classes, tmp_path / "copy").failures
    for start in ("projector.", "decoder.", "stream, ", "manifest.json: field classes: "):
        assert any(line.startswith(start) for line in failures)


def test_a_window_that_never_holds_two_frames_is_caught_and_named(bundle, tmp_path):
    failures = judge(bundle, compound_faults.window_of_one_frame, tmp_path / "copy").failures
    for field in ("perception.lower_m", "window.largest_speed_m_s", "window.largest_time_delta_s"):
        assert any(line.startswith(f"manifest.json: field {field}") for line in failures)
    assert "stream, frame 1: the window has 1 frames, expected 2" in failures


def test_a_seed_always_gives_the_same_fault(bundle):
    assert structural_fault(7, bundle).name == structural_fault(7, bundle).name
    faults = [structural_fault(seed, bundle) for seed in range(150)]
    assert {fault.kind for fault in faults} == set(KINDS)
    assert len({fault.name for fault in faults}) > 120
