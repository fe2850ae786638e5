"""The input contract holds the image settings and window of a configuration, with the limits of the manifest."""

from dataclasses import replace

from duospacenet.model import PRESETS
from duospacenet.weights.input_contract import preprocessing, temporal_window


def test_the_preprocessing_has_the_image_settings_of_the_configuration():
    contract = preprocessing(PRESETS["base"])
    assert (contract.width_px, contract.height_px) == (1600, 640)
    assert contract.colour_order == "bgr"  # of the images; the colour order of the backbone is in the graph
    assert contract.normalisation_in_graph.mean == (103.53, 116.28, 123.675)
    assert preprocessing(PRESETS["nano"]).normalisation_in_graph.colour_order == "rgb"


def test_the_window_has_the_frames_of_the_configuration_and_the_limits_of_a_road_vehicle():
    window = temporal_window(replace(PRESETS["tiny"], num_frames=3))
    assert window.num_frames == 3
    assert (window.nominal_time_delta_s, window.largest_time_delta_s) == (0.5, 2.0)
    assert (window.largest_speed_m_s, window.largest_turn_rad_s) == (70.0, 3.1416)
