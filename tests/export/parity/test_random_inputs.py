"""Random inputs lie in the legal domain of a graph, cover it, and depend on the seed alone."""

import numpy as np
import pytest
import torch

from duospacenet.export.graphs import build_graphs
from duospacenet.export.parity.random_inputs import RandomInputs

SCALE = 3.0


class _AnyScale(dict):
    def __missing__(self, name: str) -> float:
        return SCALE


@pytest.fixture(scope="module")
def graphs(tiny_model):
    return {graph.name: graph for graph in build_graphs(tiny_model)}


@pytest.fixture(scope="module")
def sample(tiny_model, graphs):
    def sample_inputs(name, seed=0, **options):
        return RandomInputs(tiny_model, _AnyScale(), seed).sample(graphs[name], **options)

    return sample_inputs


@pytest.mark.parametrize("name", ["projector", "backbone", "lifter", "decoder", "segmenter"])
def test_inputs_have_the_shapes_and_types_of_the_graph_and_depend_on_the_seed_alone(name, graphs, sample):
    inputs, again, others = sample(name), sample(name), sample(name, seed=1)
    for key, spec in graphs[name].inputs.items():
        assert (inputs[key].shape, inputs[key].dtype) == (spec.shape, spec.dtype)
        assert torch.equal(inputs[key].nan_to_num(), again[key].nan_to_num())
    assert any(not torch.equal(inputs[key], others[key]) for key in inputs)


def test_slot_0_is_the_current_frame(sample):
    for seed in range(20):
        inputs = sample("decoder", seed)
        assert bool(inputs["frame_valid"][0])
        assert torch.equal(inputs["past_T_now"][0], torch.eye(4))
        assert inputs["time_delta_s"][0] == 0


def test_every_flag_has_both_values_in_a_dozen_inputs(sample):
    random_inputs = [sample("decoder", seed) for seed in range(12)]
    cameras = torch.stack([inputs["camera_valid"] for inputs in random_inputs])
    frames = torch.stack([inputs["frame_valid"] for inputs in random_inputs])[:, 1:]
    assert cameras.any(dim=0).all() and not cameras.all(dim=0).any()
    assert frames.any(dim=0).all() and not frames.all(dim=0).any()
    everything = sample("decoder", all_valid=True)
    assert everything["camera_valid"].all() and everything["frame_valid"].all()


def test_an_empty_slot_holds_nan_and_other_slots_do_not(sample):
    num_empty = 0
    for seed in range(12):
        inputs = sample("decoder", seed)
        for slot in range(4):
            empty = not inputs["frame_valid"][slot]
            num_empty += empty
            for name in ("image_T_ego", "past_T_now", "time_delta_s"):
                assert bool(inputs[name][slot].isnan().all() if empty else inputs[name][slot].isfinite().all())
            for name in (f"slot{slot}.pv_value_0_0", f"slot{slot}.bev_value_1"):
                assert bool(inputs[name].isnan().all() if empty else inputs[name].isfinite().all())
    assert num_empty > 3


def test_some_cameras_are_just_closer_to_a_query_than_the_nearest_visible_depth_and_some_just_beyond(
    sample, tiny_model
):
    """Depths by hand: the third row of image_T_ego. Visible are depths above 0.1 m."""
    queries = torch.cat((tiny_model.queries.pose[:, :3], torch.ones(32, 1)), dim=1).detach().double()
    calibrations = torch.cat([sample("decoder", seed)["image_T_ego"][0] for seed in range(12)]).double()
    depths = (calibrations[:, 2] @ queries.T).flatten()
    assert ((depths > 0.1) & (depths < 0.105)).sum() >= 2
    assert ((depths < 0.1) & (depths > 0.095)).sum() >= 2
    assert ((depths > 0.06) & (depths < 0.095)).any()


def test_every_third_input_has_large_motions_ages_focal_lengths_and_features(sample, tiny_model):
    near, wide = sample("decoder", 1, all_valid=True), sample("decoder", 2, all_valid=True)
    assert near["past_T_now"][1:, :3, 3].abs().max() < 50 < wide["past_T_now"][1:, :3, 3].abs().max()
    assert near["time_delta_s"].max() < 3.1
    assert max(sample("decoder", seed, all_valid=True)["time_delta_s"].max() for seed in (2, 5, 8, 11)) > 4
    assert near["slot0.bev_value_0"].square().mean() == pytest.approx(SCALE**2, rel=1e-4)
    assert wide["slot0.bev_value_0"].square().mean() == pytest.approx(100 * SCALE**2, rel=1e-4)


def test_motions_are_rigid_and_have_six_degrees_of_freedom(sample):
    motions = (
        torch.cat([sample("decoder", seed, all_valid=True)["past_T_now"][1:] for seed in range(8)]).double().numpy()
    )
    rotations = motions[:, :3, :3]
    np.testing.assert_allclose(rotations @ rotations.transpose(0, 2, 1), np.tile(np.eye(3), (24, 1, 1)), atol=1e-6)
    np.testing.assert_allclose(np.linalg.det(rotations), 1, atol=1e-6)
    vectors = rotations[:, [2, 0, 1], [1, 2, 0]] - rotations[:, [1, 2, 0], [2, 0, 1]]
    assert np.linalg.matrix_rank(np.hstack((vectors, motions[:, :3, 3])), tol=0.1) == 6


def test_nearby_inputs_turn_the_ego_by_half_a_radian_at_most_and_others_by_more(sample):
    """The limits are 0.1, 0.1 and 0.5 rad in roll, pitch and yaw. The angle about the common axis is their norm."""
    angles = {}
    for seed in (1, 2, 4, 5):
        rotations = sample("decoder", seed, all_valid=True)["past_T_now"][1:, :3, :3].double().numpy()
        angles[seed] = np.arccos(np.clip((np.trace(rotations, axis1=1, axis2=2) - 1) / 2, -1, 1)).max()
    assert 0.05 < min(angles[1], angles[4]) <= max(angles[1], angles[4]) < 0.53
    assert max(angles[2], angles[5]) > 1


def test_cameras_are_not_mirrored_and_look_in_all_directions(sample):
    """The first three columns of image_T_ego are K R. Their determinant is positive, as those of K and R are."""
    calibrations = np.concatenate([sample("decoder", seed, all_valid=True)["image_T_ego"] for seed in range(8)])
    rotated = calibrations[..., :3].astype(np.float64).reshape(-1, 3, 3)
    assert (np.linalg.det(rotated) > 0).all()
    view = rotated[:, 2] / np.linalg.norm(rotated[:, 2], axis=1, keepdims=True)  # the last row of K is (0, 0, 1)
    assert (view.min(axis=0) < -0.8).all() and (view.max(axis=0) > 0.8).all()


def test_frames_are_older_from_slot_to_slot(sample):
    ages = torch.stack([sample("decoder", seed, all_valid=True)["time_delta_s"] for seed in range(8)])
    assert (ages.diff(dim=1) > 0).all()


def test_most_cameras_see_some_points_around_the_ego_and_miss_others(sample, tiny_model):
    """Points on circles of 10 and 30 m around the ego, projected by hand."""
    angles = np.linspace(0, 2 * np.pi, 72, endpoint=False)
    points = np.array([[r * np.cos(a), r * np.sin(a), 0.5, 1] for r in (10, 30) for a in angles])
    calibrations = sample("decoder", all_valid=True)["image_T_ego"].double().numpy()
    u, v, depth = np.moveaxis(calibrations @ points.T, 2, 0)
    size = tiny_model.config.image
    depths = np.maximum(depth, 1e-9)
    seen = (depth > 0.1) & (u / depths >= 0) & (u / depths < size.width_px)
    seen &= (v / depths >= 0) & (v / depths < size.height_px)
    fractions = seen.mean(axis=-1)
    assert fractions.shape == (4, 6)
    # The others are placed beside a query, and look anywhere.
    assert ((fractions > 0.05) & (fractions < 0.6)).sum() > 12


def test_voxels_are_anywhere_in_the_image_and_visible_in_some_cameras(sample):
    inputs = sample("lifter")
    locations, visible = inputs["voxel_locations"], inputs["voxel_visible"]
    assert ((locations >= 0) & (locations <= 1)).all()
    assert locations.min() < 0.05 and locations.max() > 0.95
    assert 0.3 < visible.float().mean() < 0.5
    assert not visible.any(dim=0).all()


def test_features_have_the_given_scale(sample):
    assert float(sample("segmenter")["bev"].square().mean().sqrt()) == pytest.approx(SCALE, rel=1e-5)
