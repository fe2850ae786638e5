"""The decoder's recurrence, a decoder layer and the whole decoder, against the paper's equations."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from duospacenet.model.cross_attention import LayerCache, TemporalRecurrence
from duospacenet.model.decoder import DecoderLayer, DuoSpaceDecoder, FrameCache
from duospacenet.model.window import TemporalQueries
from tests.helpers import references
from tests.helpers.model_inputs import (
    ASYMMETRIC,
    assert_close,
    bev_features,
    normal,
    pv_features,
    random_poses,
    random_window,
    with_random_weights,
)

FRAMES, QUERIES, CHANNELS = 3, 10, 32
UNIT = np.array([40, 15, 5, 1, 1, 1, 1, 1, 10, 10])  # of the pose encoder, for the range of ASYMMETRIC

ALL = (True, True, True)


# --- The recurrence -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("valid", [ALL, (True, False, True), (True, True, False), (True, False, False), (False,) * 3])
def test_the_recurrence_equals_the_loop(valid):
    recurrence = with_random_weights(TemporalRecurrence(CHANNELS)).double()
    attended = [normal(QUERIES, CHANNELS, seed=t).double() for t in range(FRAMES)]
    expected = references.recurrence(references.weights_of(recurrence), [a.numpy() for a in attended], valid)
    result = recurrence(attended, torch.tensor(valid))
    np.testing.assert_allclose(result.detach().numpy(), expected, rtol=1e-12, atol=1e-12)


def halving_recurrence():
    """A recurrence with one channel: state ← state / 2 + attended, for numbers of at least 0."""
    recurrence = TemporalRecurrence(1)
    with torch.no_grad():
        for layer in recurrence.mlp[::2]:
            layer.bias.zero_()
        recurrence.mlp[0].weight.copy_(torch.tensor([[0.5, 1.0]]))
        recurrence.mlp[2].weight.fill_(1.0)
        recurrence.mlp[4].weight.fill_(1.0)
    return recurrence


@pytest.mark.parametrize(
    ("valid", "expected"),
    [
        (ALL, (100 / 2 + 10) / 2 + 1),  # index 0 is the current frame, so the oldest is halved twice
        ((True, True, False), 10 / 2 + 1),
        ((True, False, True), 100 / 2 + 1),
        ((True, False, False), 1),
    ],
)
def test_the_recurrence_goes_from_the_oldest_frame_to_the_newest(valid, expected):
    attended = [torch.tensor([[number]]) for number in (1.0, 10.0, 100.0)]
    assert halving_recurrence()(attended, torch.tensor(valid)).item() == expected


def test_the_values_of_a_masked_frame_do_not_change_the_state():
    recurrence = with_random_weights(TemporalRecurrence(CHANNELS))
    attended = [normal(QUERIES, CHANNELS, seed=t) for t in range(FRAMES)]
    valid = torch.tensor((True, False, True))
    expected = recurrence(attended, valid)
    for garbage in (float("nan"), float("inf"), -1e30):
        attended[1] = torch.full_like(attended[1], garbage)
        assert torch.equal(recurrence(attended, valid), expected)


# --- One layer ----------------------------------------------------------------------------------------------------


def features_of(num_frames):
    return [(pv_features(ASYMMETRIC, seed=t), bev_features(ASYMMETRIC, seed=t)) for t in range(num_frames)]


def as_arrays(features):
    """PV features and BEV features as arrays, for the references."""
    pv = [[level.double().numpy() for level in pv] for pv, _ in features]
    return pv, [bev[0].double().numpy() for _, bev in features]


def window_with(valid, lost=()):
    """A window of three frames. lost: pairs of a frame and a lost camera."""
    window = random_window(ASYMMETRIC, FRAMES)._replace(frame_valid=torch.tensor(valid))
    for frame, camera in lost:
        window.camera_valid[frame, camera] = False
    return window


def arrays_of(window):
    return {
        name: (field if field.dtype == torch.bool else field.double()).numpy()
        for name, field in window._asdict().items()
    }


def contents(config, seed=1):
    return normal(QUERIES, config.content_channels, seed=seed)


def with_queries(kind):
    return replace(ASYMMETRIC, queries=kind)


KINDS = ("duo", "shared_content", "unshared", "bev", "pv")


def layer_equals_the_equations(config, valid, lost):
    layer, window, features = with_random_weights(DecoderLayer(config)), window_with(valid, lost), features_of(FRAMES)
    content = contents(config)
    poses = torch.stack([random_poses(config, QUERIES, seed=t) for t in range(FRAMES)])
    embeddings = normal(FRAMES, QUERIES, CHANNELS, seed=3)
    attention = layer.cross_attention
    values = LayerCache(
        [attention.pv.project_values(pv) for pv, _ in features] if config.attends_pv else [],
        [attention.bev.project_values(bev) for _, bev in features] if config.attends_bev else [],
    )

    new_content, prediction = layer(content, TemporalQueries(poses, embeddings), values, window)

    expected_content, class_logits, pose = references.decoder_layer(
        references.weights_of(layer),
        config,
        content.double().numpy(),
        poses.double().numpy(),
        embeddings.double().numpy(),
        *as_arrays(features),
        arrays_of(window),
    )
    assert_close(new_content, expected_content)
    assert_close(prediction.class_logits, class_logits)
    assert_close(prediction.pose, pose)
    assert_close(prediction.pose - poses[0], pose - poses[0].double().numpy())


@pytest.mark.parametrize(
    ("valid", "lost"), [(ALL, ()), ((True, False, True), ()), ((True, True, False), ((0, 1), (0, 4), (1, 2)))]
)
def test_a_decoder_layer_equals_the_papers_equations(valid, lost):
    layer_equals_the_equations(ASYMMETRIC, valid, lost)


@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind != "duo"])
def test_a_layer_with_other_kinds_of_queries_equals_the_papers_description(kind):
    layer_equals_the_equations(with_queries(kind), (True, False, True), ((0, 1), (2, 3)))


# --- The whole decoder --------------------------------------------------------------------------------------------


def decode(decoder, content, pose, features, window):
    caches = [FrameCache(decoder.cache_pv(pv), decoder.cache_bev(bev)) for pv, bev in features]
    return decoder(content, pose, caches, window)


def decode_by_equations(decoder, content, pose, features, window):
    """In each layer the poses are moved back frame by frame, embedded, decoded and refined."""
    config, weights, predictions = decoder.config, references.weights_of(decoder), []
    content, pose, arrays = content.double().numpy(), pose.double().numpy(), arrays_of(window)
    past_T_now, ages_s = arrays["past_T_now"], arrays["time_delta_s"]
    pv, bev = as_arrays(features)
    if config.fuses_bev:
        fuse = {"stacking": references.recurrent_stacking, "attention": references.temporal_self_attention}
        bev = [fuse[config.bev_temporal](references.part(weights, "bev_fusion"), bev, arrays, config)]
    for number in range(len(decoder.layers)):
        poses = np.stack([[moved_back(p, past_T_now, ages_s, t) for p in pose] for t in range(len(ages_s))])
        embeddings = references.pose_encoder(references.part(weights, "pose_encoder"), poses, UNIT)
        layer = references.part(weights, f"layers.{number}")
        content, class_logits, pose = references.decoder_layer(
            layer, config, content, poses, embeddings, pv, bev, arrays
        )
        predictions.append((class_logits, pose))
    return predictions


def moved_back(pose, past_T_now, ages_s, t):
    """One pose vector (10) in frame t, after t steps of the recursion."""
    state = pose[:3], np.array([pose[7], pose[6], 0]), np.array([*pose[8:], 0])
    for step in range(1, t + 1):
        previous_T_next = past_T_now[step] @ np.linalg.inv(past_T_now[step - 1])
        state = references.step_back_in_space(state, previous_T_next, ages_s[step] - ages_s[step - 1])
    position, heading, velocity = state
    return np.array([*position, *pose[3:6], heading[1], heading[0], *velocity[:2]])


@pytest.mark.parametrize(
    "rows",
    [
        {},
        {"bev_temporal": "stacking"},
        {"bev_temporal": "attention"},
        {"queries": "shared_content"},
        {"queries": "bev"},
    ],
    ids=str,
)
def test_the_decoder_equals_a_sequence_of_its_layers(rows):
    """Each layer uses the content and the pose of the previous layer, and moves this pose back in time again."""
    config = replace(ASYMMETRIC, **rows)
    decoder, window, features = with_random_weights(DuoSpaceDecoder(config)), window_with(ALL), features_of(FRAMES)
    content, pose = contents(config), random_poses(config, QUERIES, seed=3)

    predictions = decode(decoder, content, pose, features, window)

    expected = decode_by_equations(decoder, content, pose, features, window)
    assert len(predictions) == len(expected) == 2
    for prediction, (class_logits, refined) in zip(predictions, expected, strict=True):
        assert_close(prediction.class_logits, class_logits, 1e-4)
        assert_close(prediction.pose, refined, 1e-4)


def test_a_window_may_have_one_frame():
    decoder, features = with_random_weights(DuoSpaceDecoder(ASYMMETRIC)), features_of(FRAMES)
    content, pose = contents(ASYMMETRIC), random_poses(ASYMMETRIC, QUERIES, seed=3)
    masked = decode(decoder, content, pose, features, window_with((True, False, False)))
    alone = decode(decoder, content, pose, features[:1], window_with(ALL).newest(1))
    assert_close(alone[-1].pose, masked[-1].pose.detach())
    assert_close(alone[-1].class_logits, masked[-1].class_logits.detach())
