"""The eager-mode stream gives the same detections as the runtime's stream."""

import numpy as np
import pytest

from duospacenet.export.parity.eager_stream import EagerStream
from duospacenet.runtime.errors import InputError
from tests.helpers.streams import lose_cameras


@pytest.fixture
def eager(tiny_model, pipeline) -> EagerStream:
    return EagerStream(tiny_model)


def assert_same_detections(expected, actual) -> None:
    """Assert equal boxes per query and equal scores per query and class, within the parity tolerances."""
    assert expected.history.frames == actual.history.frames
    assert set(expected.queries) == set(actual.queries)
    orders = [np.lexsort((detections.classes, detections.queries)) for detections in (expected, actual)]
    for field, tolerance in (("boxes", 1e-3), ("scores", 1e-3), ("queries", 0)):
        values = [getattr(d, field)[order] for d, order in zip((expected, actual), orders, strict=True)]
        np.testing.assert_allclose(values[1], values[0], atol=tolerance, rtol=0)
    assert expected.maps.keys() == actual.maps.keys()
    for name, mask in expected.maps.items():
        np.testing.assert_allclose(actual.maps[name], mask, atol=1e-3)


def test_it_equals_the_bundles_stream_through_a_skipped_frame_a_reset_and_a_scene_cut(
    eager, pipeline, frames, other_frames
):
    stream = pipeline.stream(maps=True)
    window_sizes = []
    for frame in (
        *frames[:3],
        lose_cameras(frames[3], *frames[3].images),
        frames[4],
        "reset",
        frames[5],
        other_frames[0],
    ):
        if frame == "reset":
            stream.reset()
            eager.reset()
            continue
        expected, actual = stream.step(frame), eager.step(frame)
        window_sizes.append(actual.history.frames)
        assert_same_detections(expected, actual)
        assert (actual.skipped, actual.token) == (expected.skipped, expected.token)
    assert window_sizes == [1, 2, 3, 0, 4, 1, 1]


def test_an_invalid_frame_is_refused(eager, frames):
    with pytest.raises(InputError, match="expected 1 to 6"):
        eager.step(type(frames[0])({}, {}, np.eye(4), 0.0))
