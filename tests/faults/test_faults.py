"""Every seeded fault is caught by the right check. This is a mutation test of the parity check."""

from collections import Counter

import pytest

from duospacenet.runtime import history, pipeline, preprocessing
from tests.faults.catalogue import FAULTS, NO_FAULT, try_fault


def test_no_check_fails_without_a_fault(tiny_bundle, tiny_model):
    assert try_fault(NO_FAULT, tiny_bundle, tiny_model).caught_by == ()


@pytest.mark.parametrize("fault", FAULTS, ids=lambda fault: f"{fault.where}: {fault.name}")
def test_a_fault_is_caught_by_the_right_check(fault, tiny_bundle, tiny_model, tiny_traces):
    trial = try_fault(fault, tiny_bundle, tiny_model, tiny_traces if fault.bisected else None)
    assert trial.is_caught, trial.caught_by
    if fault.where in ("input", "history", "result"):
        assert not trial.report.failing_outputs
    if fault.bisected:
        assert trial.bisection.place == fault.bisected


def test_a_trial_undoes_its_fault(tiny_bundle, tiny_model):
    step, inverse, prepare = pipeline.Stream.step, history.inverse, preprocessing.prepare
    for name in ("images of two cameras exchanged", "ego motion inverted", "lost cameras marked valid"):
        try_fault(next(fault for fault in FAULTS if fault.name == name), tiny_bundle, tiny_model)
    assert (pipeline.Stream.step, history.inverse, preprocessing.prepare) == (step, inverse, prepare)
    assert not try_fault(NO_FAULT, tiny_bundle, tiny_model).caught_by


def test_the_catalogue_has_unique_faults_of_every_kind():
    counts = Counter(fault.where for fault in FAULTS)
    assert len({(fault.where, fault.name) for fault in FAULTS}) == len(FAULTS) >= 25
    graphs = {"backbone", "lifter", "projector", "decoder", "segmenter"}
    assert counts.keys() == graphs | {"manifest", "model", "input", "history", "result", "shared"}
