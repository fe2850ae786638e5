"""Wrong elements of inputs are found and named, whatever graph ignores them."""

import pytest
import torch

from duospacenet.export.graphs import build_graphs
from duospacenet.export.parity.liveness import check_liveness


@pytest.fixture(scope="module")
def decoder(tiny_model):
    return next(graph for graph in build_graphs(tiny_model) if graph.name == "decoder")


@pytest.fixture(scope="module")
def inputs(decoder):
    return {name: torch.ones(spec.shape, dtype=spec.dtype) for name, spec in decoder.inputs.items()}


def ignoring(inputs, *places):
    """A comparison that fails if and only if one of these places, as (input, index), has changed."""
    return lambda changed: all(torch.equal(changed[name][index], inputs[name][index]) for name, index in places)


def test_without_a_fault_nothing_is_wrong_and_every_element_is_counted(decoder, inputs):
    result = check_liveness(decoder, inputs, lambda changed: True)
    assert (result.elements, result.wrong) == (554, [])


PLACES = {
    "decoder.camera_valid[slot 3, camera 1]": ("camera_valid", (3, 1)),
    "decoder.frame_valid[slot 2]": ("frame_valid", (2,)),
    "decoder.past_T_now[slot 1, row 2, column 0]": ("past_T_now", (1, 2, 0)),
    "decoder.time_delta_s[slot 3]": ("time_delta_s", (3,)),
    "decoder.image_T_ego[slot 2, camera 5, row 1, column 3]": ("image_T_ego", (2, 5, 1, 3)),
    "decoder.slot1.pv_value_0_2[camera 4]": ("slot1.pv_value_0_2", (4,)),
    "decoder.slot3.bev_value_1": ("slot3.bev_value_1", ()),
}


@pytest.mark.parametrize("name", PLACES)
def test_a_single_ignored_element_is_named(name, decoder, inputs):
    assert check_liveness(decoder, inputs, ignoring(inputs, PLACES[name])).wrong == [name]


def test_several_ignored_elements_are_named(decoder, inputs):
    names = list(PLACES)[:4]
    wrong = check_liveness(decoder, inputs, ignoring(inputs, *(PLACES[name] for name in names))).wrong
    assert sorted(wrong) == sorted(names)


def test_at_most_four_elements_of_a_graph_are_located(decoder, inputs):
    runs = []

    def differs_always(changed):
        runs.append(changed)
        return False

    assert len(check_liveness(decoder, inputs, differs_always).wrong) == 4
    assert len(runs) < 100


def test_elements_that_fail_only_together_are_reported(decoder, inputs):
    def fails_together(changed):
        return sum(not torch.equal(changed[name], inputs[name]) for name in ("past_T_now", "image_T_ego")) < 2

    wrong = check_liveness(decoder, inputs, fails_together).wrong
    assert wrong and all("together with" in line or "[" in line for line in wrong)
