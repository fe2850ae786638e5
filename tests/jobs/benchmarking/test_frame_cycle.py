"""The repeated frames of a benchmark: their order, their times, and that a stream never resets."""

from dataclasses import replace
from itertools import islice, pairwise

import numpy as np
import pytest

from duospacenet.data.scene_writer import write_scene
from duospacenet.jobs.benchmarking.frame_cycle import MAX_DISTINCT, FrameCycle, decode_frames
from duospacenet.runtime.errors import InputError
from duospacenet.runtime.history import find_reset
from duospacenet.synthetic.drive import SyntheticDrive
from tests.helpers.streams import TINY_SIZE_PX, lose_cameras, move_ego


def test_frames_are_repeated_forwards_and_backwards(frames):
    repeated = list(islice(FrameCycle(frames[:3], 0.5), 9))
    origins = [
        next(i for i, frame in enumerate(frames) if frame.global_T_ego is each.global_T_ego) for each in repeated
    ]
    assert origins == [0, 1, 2, 1, 0, 1, 2, 1, 0]


def test_time_advances_by_the_time_between_the_neighbours(frames):
    times = [0.0, 0.4, 1.4]
    timed = [replace(frame, timestamp_s=time_s) for frame, time_s in zip(frames, times, strict=False)]
    repeated = list(islice(FrameCycle(timed, 0.5), 6))
    assert np.diff([frame.timestamp_s for frame in repeated]) == pytest.approx([0.4, 1.0, 1.0, 0.4, 0.4])


def test_a_single_frame_is_repeated_at_the_nominal_time(frames):
    repeated = list(islice(FrameCycle(frames[:1], 0.5), 3))
    assert np.diff([frame.timestamp_s for frame in repeated]) == pytest.approx([0.5, 0.5])


@pytest.mark.parametrize("count", [1, 2, 6])
def test_no_neighbours_reset_the_history(frames, pipeline, count):
    repeated = list(islice(FrameCycle(frames[:count], 0.5), 3 * count + 2))
    for last, frame in pairwise(repeated):
        assert find_reset(last, frame, pipeline.manifest.window) is None


def test_the_window_of_a_stream_stays_full(frames, pipeline):
    stream = pipeline.stream()
    results = [stream.step(frame) for frame in islice(FrameCycle(frames[:2], 0.5), 8)]
    assert [result.history.frames for result in results] == [1, 2, 3, 4, 4, 4, 4, 4]
    assert all(result.history.reset_reason is None for result in results)


def test_without_a_source_the_frames_have_the_size_of_real_images(pipeline):
    name, decoded = decode_frames(None, pipeline.manifest)
    assert len(decoded) == MAX_DISTINCT
    assert "1600×900" in name
    assert {image.shape for frame in decoded for image in frame.images.values()} == {(900, 1600, 3)}


def test_frames_after_a_reset_and_frames_with_lost_cameras_are_left_out(tmp_path, pipeline):
    """Frame 1 has lost a camera, and frame 4 is 1 km away."""
    drive = list(SyntheticDrive(3, frames=6, image_size=TINY_SIZE_PX))
    drive[1] = lose_cameras(drive[1], "CAM_FRONT")
    drive[4:] = [move_ego(frame, 1000.0) for frame in drive[4:]]
    write_scene(tmp_path / "scene", drive)
    _, decoded = decode_frames(tmp_path / "scene", pipeline.manifest, check=False)
    assert [frame.timestamp_s for frame in decoded] == [drive[index].timestamp_s for index in (0, 2, 3)]


def test_frames_with_lost_cameras_are_used_if_there_are_no_others(tmp_path, pipeline):
    drive = [lose_cameras(frame, "CAM_FRONT") for frame in SyntheticDrive(3, frames=2, image_size=TINY_SIZE_PX)]
    write_scene(tmp_path / "scene", drive)
    assert len(decode_frames(tmp_path / "scene", pipeline.manifest, check=False)[1]) == 2


def test_a_source_without_any_image_is_refused(tmp_path, pipeline):
    drive = [lose_cameras(frame, *frame.cameras) for frame in SyntheticDrive(3, frames=2, image_size=TINY_SIZE_PX)]
    write_scene(tmp_path / "scene", drive)
    with pytest.raises(InputError, match="expected a frame with an image; got none in the first 2 frames"):
        decode_frames(tmp_path / "scene", pipeline.manifest, check=False)
