"""Structural faults in a bundle, sampled by seed, are caught by the `parity` command alone."""

import pytest

from tests.faults import compound_faults
from tests.faults.parity_command import judge, run_parity
from tests.faults.structural_faults import KINDS, structural_fault
from tests.helpers.bundles import edit_manifest

SEEDS = range(1000, 1010)


@pytest.fixture
def bundle(copied_bundle):
    """A bundle as `export --random-weights` writes it."""
    return edit_manifest(copied_bundle, lambda manifest: manifest["weights"].update(trained=False))


def test_a_bundle_without_a_fault_passes(bundle):
    assert run_parity(bundle).exit_code == 0


@pytest.mark.parametrize("seed", SEEDS)
def test_a_structural_fault_is_caught(bundle, tmp_path, seed):
    fault = structural_fault(seed, bundle)
    verdict = judge(bundle, fault.inject, tmp_path / "copy")
    assert verdict.is_caught, fault.name


@pytest.mark.parametrize("inject", [compound_faults.masks_motion_and_classes, compound_faults.window_of_one_frame])
def test_several_faults_at_once_are_caught_and_named(bundle, tmp_path, inject):
    verdict = judge(bundle, inject, tmp_path / "copy")
    assert verdict.exit_code == 1
    field = "classes" if inject is compound_faults.masks_motion_and_classes else "window.largest_speed_m_s"
    assert any(field in line for line in verdict.failures)


def test_the_graphs_of_the_first_compound_bundle_fail_by_themselves(bundle, tmp_path):
    verdict = judge(bundle, compound_faults.masks_motion_and_classes, tmp_path / "copy")
    for graph in ("projector", "decoder"):
        assert any(line.startswith(f"{graph}.") for line in verdict.failures)


def test_a_seed_always_gives_the_same_fault(bundle):
    assert structural_fault(7, bundle).name == structural_fault(7, bundle).name
    faults = [structural_fault(seed, bundle) for seed in range(150)]
    assert {fault.kind for fault in faults} == set(KINDS)
    assert len({fault.name for fault in faults}) > 130
