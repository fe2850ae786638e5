"""The model in eager mode as a stream, beside the runtime's own over the same frames."""

import numpy as np
import pytest

from duospacenet.export.parity.eager_stream import EagerStream
from duospacenet.runtime.errors import InputError
from tests.helpers.streams import lose_cameras


@pytest.fixture
def eager(tiny_model, pipeline) -> EagerStream:
    return EagerStream(tiny_model, pipeline.manifest)


def assert_same(one, other) -> None:
    """Equal boxes by query and equal scores by query and class, within what parity allows."""
    assert one.history.frames == other.history.frames
    assert dict(zip(one.queries, map(tuple, one.boxes), strict=True)).keys() == set(other.queries)
    rows = [np.lexsort((answer.classes, answer.queries)) for answer in (one, other)]
    for field, tolerance in (("boxes", 1e-3), ("scores", 1e-3), ("queries", 0)):
        expected, got = (getattr(answer, field)[row] for answer, row in zip((one, other), rows, strict=True))
        np.testing.assert_allclose(got, expected, atol=tolerance, rtol=0)
    assert one.maps.keys() == other.maps.keys()
    for name, mask in one.maps.items():
        np.testing.assert_allclose(other.maps[name], mask, atol=1e-3)


def test_it_answers_as_the_bundle_while_the_window_fills_and_after_a_reset_a_cut_and_a_lost_frame(
    eager, pipeline, frames, other_frames
):
    stream = pipeline.stream(maps=True)
    windows = []
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
        expected, got = stream.step(frame), eager.step(frame)
        windows.append(got.history.frames)
        assert_same(expected, got)
        assert (got.skipped, got.token) == (expected.skipped, expected.token)
    assert windows == [1, 2, 3, 0, 4, 1, 1]


def test_a_frame_that_cannot_be_right_is_refused(eager, frames):
    with pytest.raises(InputError, match="expected 1 to 6"):
        eager.step(type(frames[0])({}, {}, np.eye(4), 0.0))
