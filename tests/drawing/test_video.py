"""Writing videos: complete, in order, or not at all."""

import resource

import cv2
import numpy as np
import pytest

from duospacenet.drawing.video import VideoWriter, count_frames, fit_into
from duospacenet.runtime.errors import OutputError

GREYS = (20, 80, 140, 200, 240)


def plain_picture(grey, width=64, height=48):
    return np.full((height, width, 3), grey, np.uint8)


def read_video(path):
    video = cv2.VideoCapture(str(path))
    pictures = []
    while True:
        more, picture = video.read()
        if not more:
            return pictures, video.get(cv2.CAP_PROP_FPS)
        pictures.append(picture)


def test_a_video_has_every_picture_in_order(tmp_path):
    with VideoWriter(tmp_path / "a.mp4", frames_per_second=4) as video:
        for grey in GREYS:
            video.write(plain_picture(grey))
    pictures, frames_per_second = read_video(tmp_path / "a.mp4")
    assert [picture.shape for picture in pictures] == [(48, 64, 3)] * 5
    np.testing.assert_allclose([picture.mean() for picture in pictures], GREYS, atol=6)
    assert frames_per_second == 4
    assert [path.name for path in tmp_path.iterdir()] == ["a.mp4"]


def test_the_file_appears_only_when_it_is_complete(tmp_path):
    with VideoWriter(tmp_path / "a.mp4") as video:
        video.write(plain_picture(20))
        assert not (tmp_path / "a.mp4").exists()
    assert (tmp_path / "a.mp4").exists()


def test_after_an_exception_the_old_file_is_kept_and_no_other_file_is_left(tmp_path):
    (tmp_path / "a.mp4").write_bytes(b"old")
    with pytest.raises(KeyboardInterrupt), VideoWriter(tmp_path / "a.mp4") as video:
        video.write(plain_picture(20))
        raise KeyboardInterrupt
    assert (tmp_path / "a.mp4").read_bytes() == b"old"
    assert [path.name for path in tmp_path.iterdir()] == ["a.mp4"]


def test_a_video_that_cannot_be_opened_is_refused_with_its_path(tmp_path):
    with (
        pytest.raises(OutputError, match=r"missing/a\.mp4") as error,
        VideoWriter(tmp_path / "missing" / "a.mp4") as video,
    ):
        video.write(plain_picture(20))
    assert error.value.exit_code == 5


def test_a_video_without_pictures_is_refused(tmp_path):
    with pytest.raises(OutputError, match="at least one picture"), VideoWriter(tmp_path / "a.mp4"):
        pass
    assert list(tmp_path.iterdir()) == []


def test_a_full_disk_is_detected(tmp_path):
    noise = np.random.default_rng(0).integers(0, 256, (480, 640, 3), dtype=np.uint8)
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1 << 19, hard))
    try:
        with pytest.raises(OutputError, match="is the disk full"), VideoWriter(tmp_path / "a.mp4") as video:
            for shift in range(20):
                video.write(np.roll(noise, shift, axis=0))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert list(tmp_path.iterdir()) == []


def test_a_picture_of_another_size_is_scaled_to_fit_into_the_first_one(tmp_path):
    """A picture half as high as wide in a square has the full width, and black above and below."""
    square, wide = np.zeros((64, 64, 3), np.uint8), np.full((100, 200, 3), 200, np.uint8)
    fit = fit_into(wide, square.shape)
    assert fit.shape == (64, 64, 3)
    assert (fit[16:48] == 200).all()
    assert not fit[:16].any()
    assert not fit[48:].any()
    assert fit_into(square, square.shape) is square
    with VideoWriter(tmp_path / "v.mp4") as video:
        for picture in (square, wide, square):
            video.write(picture)
    assert count_frames(tmp_path / "v.mp4") == 3
