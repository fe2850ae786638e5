"""The decoder layer, its recurrence through time, and the chain of layers, against the paper's equations."""

import numpy as np
import pytest
import references
import torch
from samples import LOPSIDED, assert_close, bev_features, drawn, drive, normal, poses_around, pv_features

from duospacenet.model.decoder import DecoderLayer, DuoSpaceDecoder, LayerValues, TemporalRecurrence, Window
from duospacenet.model.queries import Content

FRAMES, QUERIES, CHANNELS = 3, 10, 32
UNIT = np.array([40, 15, 5, 1, 1, 1, 1, 1, 10, 10])  # the pose encoder's, of the lopsided range

ALL = (True, True, True)


# --- The recurrence -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("valid", [ALL, (True, False, True), (True, True, False), (True, False, False), (False,) * 3])
def test_the_recurrence_equals_the_loop(valid):
    recurrence = drawn(TemporalRecurrence(CHANNELS)).double()
    attended = [normal(QUERIES, CHANNELS, seed=t).double() for t in range(FRAMES)]
    expected = references.recurrence(references.weights_of(recurrence), [a.numpy() for a in attended], valid)
    result = recurrence(attended, torch.tensor(valid))
    np.testing.assert_allclose(result.detach().numpy(), expected, rtol=1e-12, atol=1e-12)


def halving_recurrence():
    """A recurrence of one channel: state ← state / 2 + attended, for numbers that are not negative."""
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
        (ALL, (100 / 2 + 10) / 2 + 1),  # index 0 is now: the oldest was halved twice
        ((True, True, False), 10 / 2 + 1),
        ((True, False, True), 100 / 2 + 1),
        ((True, False, False), 1),
    ],
)
def test_the_recurrence_goes_from_the_oldest_frame_to_the_newest(valid, expected):
    attended = [torch.tensor([[number]]) for number in (1.0, 10.0, 100.0)]
    assert halving_recurrence()(attended, torch.tensor(valid)).item() == expected


def test_a_masked_frame_passes_the_state_on_whatever_lies_in_it():
    recurrence = drawn(TemporalRecurrence(CHANNELS))
    attended = [normal(QUERIES, CHANNELS, seed=t) for t in range(FRAMES)]
    valid = torch.tensor((True, False, True))
    expected = recurrence(attended, valid)
    for garbage in (float("nan"), float("inf"), -1e30):
        attended[1] = torch.full_like(attended[1], garbage)
        assert torch.equal(recurrence(attended, valid), expected)


# --- One layer ----------------------------------------------------------------------------------------------------


def features_of(num_frames):
    return [(pv_features(LOPSIDED, seed=t), bev_features(LOPSIDED, seed=t)) for t in range(num_frames)]


def as_arrays(features):
    return [([level.double().numpy() for level in pv], bev[0].double().numpy()) for pv, bev in features]


def window_with(valid, lost=()):
    """A window of three frames; `lost`: pairs of frame and camera."""
    window = drive(LOPSIDED, FRAMES)._replace(frame_valid=torch.tensor(valid))
    for frame, camera in lost:
        window.camera_valid[frame, camera] = False
    return window


def arrays_of(window):
    return {
        "image_T_ego": window.image_T_ego.double().numpy(),
        "frame_valid": window.frame_valid.numpy(),
        "camera_valid": window.camera_valid.numpy(),
    }


@pytest.mark.parametrize(
    ("valid", "lost"), [(ALL, ()), ((True, False, True), ()), ((True, True, False), ((0, 1), (0, 4), (1, 2)))]
)
def test_a_decoder_layer_equals_the_papers_equations(valid, lost):
    layer, window, features = drawn(DecoderLayer(LOPSIDED)), window_with(valid, lost), features_of(FRAMES)
    content = Content(normal(QUERIES, CHANNELS, seed=1), normal(QUERIES, CHANNELS, seed=2))
    poses = torch.stack([poses_around(LOPSIDED, QUERIES, seed=t) for t in range(FRAMES)])
    embeddings = normal(FRAMES, QUERIES, CHANNELS, seed=3)
    values = [LayerValues(layer.pv_attention.values(pv), layer.bev_attention.values(bev)) for pv, bev in features]

    new_content, prediction = layer(content, poses, embeddings, values, window)

    expected_content, class_logits, pose = references.decoder_layer(
        references.weights_of(layer),
        LOPSIDED,
        (content.bev.double().numpy(), content.pv.double().numpy()),
        poses.double().numpy(),
        embeddings.double().numpy(),
        as_arrays(features),
        **arrays_of(window),
    )
    assert_close(new_content.bev, expected_content[0])
    assert_close(new_content.pv, expected_content[1])
    assert_close(prediction.class_logits, class_logits)
    assert_close(prediction.pose, pose)
    assert_close(prediction.pose - poses[0], pose - poses[0].double().numpy())


# --- The chain of layers ------------------------------------------------------------------------------------------


def decode(decoder, content, pose, features, window):
    per_frame = [zip(decoder.pv_values(pv), decoder.bev_values(bev), strict=True) for pv, bev in features]
    memory = [[LayerValues(*layer) for layer in frame] for frame in per_frame]
    return decoder(content, pose, memory, window)


def decode_by_equations(decoder, content, pose, features, window):
    """Every layer anew: poses moved back frame by frame in space, embedded, decoded, refined."""
    weights, predictions = references.weights_of(decoder), []
    content, pose = tuple(c.double().numpy() for c in content), pose.double().numpy()
    past_T_now, ages_s = window.past_T_now.double().numpy(), window.time_delta_s.double().numpy()
    for number in range(len(decoder.layers)):
        poses = np.stack([[moved_back(p, past_T_now, ages_s, t) for p in pose] for t in range(len(ages_s))])
        embeddings = references.pose_encoder(references.part(weights, "pose_encoder"), poses, UNIT)
        content, class_logits, pose = references.decoder_layer(
            references.part(weights, f"layers.{number}"),
            LOPSIDED,
            content,
            poses,
            embeddings,
            as_arrays(features),
            **arrays_of(window),
        )
        predictions.append((class_logits, pose))
    return predictions


def moved_back(pose, past_T_now, ages_s, t):
    """One pose vector (10) at frame t, by t steps of the recursion."""
    state = pose[:3], np.array([pose[7], pose[6], 0]), np.array([*pose[8:], 0])
    for step in range(1, t + 1):
        previous_T_next = past_T_now[step] @ np.linalg.inv(past_T_now[step - 1])
        state = references.step_back_in_space(state, previous_T_next, ages_s[step] - ages_s[step - 1])
    position, heading, velocity = state
    return np.array([*position, *pose[3:6], heading[1], heading[0], *velocity[:2]])


def test_the_decoder_equals_its_layers_one_after_the_other():
    """Each takes the content and the refined pose of the layer before it, and moves that pose through time anew."""
    decoder, window, features = drawn(DuoSpaceDecoder(LOPSIDED)), window_with(ALL), features_of(FRAMES)
    content = Content(normal(QUERIES, CHANNELS, seed=1), normal(QUERIES, CHANNELS, seed=2))
    pose = poses_around(LOPSIDED, QUERIES, seed=3)

    predictions = decode(decoder, content, pose, features, window)

    expected = decode_by_equations(decoder, content, pose, features, window)
    assert len(predictions) == len(expected) == 2
    for prediction, (class_logits, refined) in zip(predictions, expected, strict=True):
        assert_close(prediction.class_logits, class_logits, 1e-4)
        assert_close(prediction.pose, refined, 1e-4)


def test_a_window_of_one_frame_is_enough():
    decoder, features = drawn(DuoSpaceDecoder(LOPSIDED)), features_of(FRAMES)
    content = Content(normal(QUERIES, CHANNELS, seed=1), normal(QUERIES, CHANNELS, seed=2))
    pose = poses_around(LOPSIDED, QUERIES, seed=3)
    masked = decode(decoder, content, pose, features, window_with((True, False, False)))
    alone = decode(decoder, content, pose, features[:1], Window(*(field[:1] for field in window_with(ALL))))
    assert_close(alone[-1].pose, masked[-1].pose.detach())
    assert_close(alone[-1].class_logits, masked[-1].class_logits.detach())
