"""The mutation test of parity itself: every fault of the catalogue is caught, by the check that is responsible."""

from collections import Counter

import pytest

from duospacenet.runtime import history, pipeline, preprocessing
from tests.faults.catalogue import FAULTS, HEALTHY, try_fault


def test_nothing_is_caught_where_nothing_is_wrong(tiny_bundle, tiny_model):
    assert try_fault(HEALTHY, tiny_bundle, tiny_model).caught_by == ()


@pytest.mark.parametrize("fault", FAULTS, ids=lambda fault: f"{fault.where}: {fault.name}")
def test_a_fault_is_caught_by_the_check_that_is_responsible(fault, tiny_bundle, tiny_model, tiny_traces):
    trial = try_fault(fault, tiny_bundle, tiny_model, tiny_traces if fault.bisected else None)
    assert trial.is_caught, trial.caught_by
    if fault.where in ("feed", "state", "answers"):
        assert not trial.report.failing_outputs
    if fault.bisected:
        assert trial.bisection.place == fault.bisected


def test_a_fault_is_gone_when_it_has_been_tried(tiny_bundle, tiny_model):
    step, inverse, prepare_inputs = pipeline.Stream.step, history.inverse, preprocessing.prepare_inputs
    for name in ("pictures of two cameras exchanged", "ego motion turned round", "lost cameras taken for valid"):
        try_fault(next(fault for fault in FAULTS if fault.name == name), tiny_bundle, tiny_model)
    assert (pipeline.Stream.step, history.inverse, preprocessing.prepare_inputs) == (step, inverse, prepare_inputs)
    assert not try_fault(HEALTHY, tiny_bundle, tiny_model).caught_by


def test_the_catalogue_holds_faults_of_every_kind_and_each_once():
    counts = Counter(fault.where for fault in FAULTS)
    assert len({(fault.where, fault.name) for fault in FAULTS}) == len(FAULTS) >= 25
    graphs = {"backbone", "lifter", "projector", "decoder", "segmenter"}
    assert counts.keys() == graphs | {"model", "feed", "state", "answers", "shared"}
