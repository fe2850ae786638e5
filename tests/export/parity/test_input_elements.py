"""The elements of the inputs of a graph, and their groups."""

import pytest
import torch

from duospacenet.export.graphs import build_graphs
from duospacenet.export.parity.input_elements import elements_of
from duospacenet.export.parity.liveness import group_elements


@pytest.fixture(scope="module")
def graphs(tiny_model):
    return {graph.name: graph for graph in build_graphs(tiny_model)}


def test_the_elements_of_the_decoder_are_every_flag_number_and_camera(graphs):
    """4 slots, 6 cameras, 2 layers and 4 levels. Slot 0 has no motion, age and frame flag; a motion has three rows."""
    elements = elements_of(graphs["decoder"])
    counts = {name: sum(element.name == name for element in elements) for name in graphs["decoder"].inputs}
    assert counts["camera_valid"] == 4 * 6
    assert counts["image_T_ego"] == 4 * 6 * 12
    assert counts["past_T_now"] == 3 * 12
    assert counts["time_delta_s"] == counts["frame_valid"] == 3
    assert sum(counts[name] for name in counts if ".pv_" in name) == 4 * 2 * 4 * 6
    assert sum(counts[name] for name in counts if ".bev_" in name) == 4 * 2
    assert len({str(element) for element in elements}) == len(elements) == sum(counts.values())


def test_an_element_is_named_by_slot_camera_row_and_column(graphs):
    names = [str(element) for element in elements_of(graphs["decoder"])]
    assert "camera_valid[slot 3, camera 5]" in names
    assert "image_T_ego[slot 2, camera 1, row 2, column 3]" in names
    assert "past_T_now[slot 1, row 0, column 2]" in names
    assert "time_delta_s[slot 3]" in names
    assert "slot2.pv_value_1_3[camera 4]" in names
    assert "slot2.bev_value_1" in names
    assert "images[camera 2, channel 1]" in map(str, elements_of(graphs["backbone"]))


@pytest.mark.parametrize("name", ["projector", "backbone", "lifter", "decoder", "segmenter"])
def test_together_the_elements_change_every_number_that_is_not_constant(name, graphs):
    """The last row of a motion, and slot 0 of motion, age and frame flag never change."""
    graph = graphs[name]
    inputs = {key: torch.ones(spec.shape, dtype=spec.dtype) for key, spec in graph.inputs.items()}
    changed = {key: value.clone() for key, value in inputs.items()}
    generator = torch.Generator().manual_seed(0)
    for element in elements_of(graph):
        element.disturb(changed[element.name], generator)
    for key, value in changed.items():
        differs = value != inputs[key]
        if key in ("past_T_now", "time_delta_s", "frame_valid"):
            assert not differs[0].any()
            differs = differs[1:, :3] if key == "past_T_now" else differs[1:]
        assert differs.all(), key


def test_a_number_grows_by_5_to_10_percent_of_the_mean_magnitude_in_its_row(graphs):
    """The rows of a motion and of a calibration are those of its matrix. All ages are one row."""
    generator = torch.Generator().manual_seed(0)
    inputs = graphs["decoder"].inputs
    values = {name: torch.randn(inputs[name].shape) * 10 for name in ("past_T_now", "image_T_ego", "time_delta_s")}
    for element in elements_of(graphs["decoder"]):
        if element.name in values:
            value = values[element.name]
            changed = value.clone()
            element.disturb(changed, generator)
            *row, _ = element.index
            magnitude = float(value[tuple(row)].abs().mean())
            growth = (changed - value)[element.index]
            assert torch.count_nonzero(changed - value) == 1
            assert 0.0499 * magnitude <= float(growth) <= 0.1001 * magnitude


def test_no_element_of_a_group_is_masked_by_a_flag_of_the_group(graphs):
    elements = elements_of(graphs["decoder"])
    groups = group_elements(elements, 8)
    assert sorted(str(element) for group in groups for element in group) == sorted(map(str, elements))
    for group in groups:
        for flag in group:
            assert not [other for other in group if other is not flag and flag.masks(other)]
