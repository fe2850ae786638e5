"""JPEG files: OpenCV is the reference for the pixels of undamaged files."""

import cv2
import numpy as np
import pytest
import simplejpeg

from duospacenet.data.image_decoding import DamagedImageError, ImageHeader
from duospacenet.data.jpeg_file import MAX_SCANS, decode_jpeg, jpeg_header
from tests.helpers.image_files import encode, photo

PICTURE = photo(331, 203)  # not a multiple of the 16 px of a block
ENCODINGS = {
    "baseline": (cv2.IMWRITE_JPEG_QUALITY, 90),
    "progressive": (cv2.IMWRITE_JPEG_PROGRESSIVE, 1),
    "restart markers": (cv2.IMWRITE_JPEG_RST_INTERVAL, 5),
    "optimised": (cv2.IMWRITE_JPEG_OPTIMIZE, 1),
    "4:4:4": (cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444),
    "4:2:2": (cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_422),
    "4:4:0": (cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_440),
    "4:1:1": (cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_411),
}


def decode(data, reduction=1):
    return decode_jpeg(data, jpeg_header(data), reduction)


def opencv_pixels(data):
    return cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION)


def jpeg_of_scans(image, channels):
    """Return a JPEG file with three channels in its header, and a separate scan for each of `channels`."""
    greys = [encode(np.ascontiguousarray(image[..., channel]), ".jpg") for channel in range(3)]
    frame, scan = greys[0].index(b"\xff\xc0"), greys[0].index(b"\xff\xda")
    tables = greys[0][2:frame], greys[0][frame + 13 : scan]  # a start-of-frame segment of one channel has 13 bytes
    size = greys[0][frame + 4 : frame + 9]
    header = b"\xff\xc0\0\x11" + size + b"\3" + b"".join(bytes((channel, 0x11, 0)) for channel in range(3))
    scans = [
        b"\xff\xda\0\x08\x01" + bytes((channel, 0, 0, 63, 0)) + greys[channel][scan + 10 : -2] for channel in channels
    ]
    return greys[0][:2] + tables[0] + header + tables[1] + b"".join(scans) + b"\xff\xd9"


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_the_pixels_equal_those_of_opencv_bit_for_bit(encoding):
    data = encode(PICTURE, ".jpg", *ENCODINGS[encoding])
    assert np.array_equal(decode(data), opencv_pixels(data))


def test_a_grey_file_gives_the_pixels_of_opencv():
    data = encode(PICTURE[..., 0], ".jpg")
    assert jpeg_header(data).channels == 1
    assert np.array_equal(decode(data), opencv_pixels(data))


def test_a_cmyk_file_gives_the_pixels_of_opencv_and_is_refused_if_it_is_damaged():
    inks = np.dstack([PICTURE, PICTURE[..., 0]])
    data = simplejpeg.encode_jpeg(np.ascontiguousarray(inks), colorspace="CMYK", colorsubsampling="444")
    assert jpeg_header(data) == ImageHeader(331, 203, 8, 4)
    assert np.array_equal(decode(data), opencv_pixels(data))
    middle = len(data) // 2
    with pytest.raises(DamagedImageError, match="Corrupt JPEG data"):
        decode(data[:middle] + bytes(4096) + data[middle + 4096 :])


def test_the_header_skips_segments_with_a_thumbnail_and_fill_bytes():
    thumbnail = encode(PICTURE[::8, ::8], ".jpg")
    segment = b"\xff\xff\xff\xe1" + (len(thumbnail) + 2).to_bytes(2) + thumbnail
    data = encode(PICTURE, ".jpg")
    data = data[:2] + segment + data[2:]
    assert jpeg_header(data) == ImageHeader(331, 203, 8, 3)
    assert np.array_equal(decode(data), opencv_pixels(data))


@pytest.mark.parametrize(
    "data", [b"", b"\xff\xd8\xff", b"\xff\xd8\xff\xc0\0\5\x08\0\1", b"BM\xff\xc0\0\x11" + bytes(20)]
)
def test_a_file_without_a_size_has_no_header(data):
    assert jpeg_header(data) is None


def test_a_file_with_one_scan_per_channel_is_read_if_no_scan_is_missing():
    """libjpeg reports nothing if a scan is missing, and returns an image without colour."""
    data = jpeg_of_scans(PICTURE, channels=(0, 1, 2))
    assert np.array_equal(decode(data), opencv_pixels(data))
    incomplete = jpeg_of_scans(PICTURE, channels=(0,))
    assert simplejpeg.decode_jpeg(incomplete, "BGR", strict=True).shape == PICTURE.shape
    with pytest.raises(DamagedImageError, match="with data for 1 of 3 colour channels"):
        decode(incomplete)


def test_a_file_with_too_many_scans_is_refused_before_it_is_decoded(monkeypatch):
    """Each scan takes as long as the whole image, but can have a few bytes only."""
    data = encode(PICTURE, ".jpg", cv2.IMWRITE_JPEG_PROGRESSIVE, 1)
    last = data.rindex(b"\xff\xda")
    bomb = data[:-2] + data[last:-2] * MAX_SCANS + data[-2:]
    monkeypatch.setattr(simplejpeg, "decode_jpeg", lambda *_, **__: pytest.fail("the image was decoded"))
    with pytest.raises(DamagedImageError, match=rf"with 11\d scans, where at most {MAX_SCANS} are accepted"):
        decode(bomb)


# --- Decoding at a reduced size -----------------------------------------------------------------------------------

REDUCED = {2: cv2.IMREAD_REDUCED_COLOR_2, 4: cv2.IMREAD_REDUCED_COLOR_4, 8: cv2.IMREAD_REDUCED_COLOR_8}


@pytest.mark.parametrize("reduction", REDUCED)
@pytest.mark.parametrize("encoding", ENCODINGS)
def test_a_reduced_image_equals_that_of_opencv_bit_for_bit(encoding, reduction):
    data = encode(photo(320, 208), ".jpg", *ENCODINGS[encoding])
    flags = REDUCED[reduction] | cv2.IMREAD_IGNORE_ORIENTATION
    image = decode(data, reduction)
    assert image.shape == (208 // reduction, 320 // reduction, 3)
    assert np.array_equal(image, cv2.imdecode(np.frombuffer(data, np.uint8), flags))


def test_a_reduced_image_is_near_the_mean_of_each_block_of_pixels():
    image = photo(320, 208)
    data = encode(image, ".jpg", cv2.IMWRITE_JPEG_QUALITY, 95)
    means = image.reshape(52, 4, 80, 4, 3).mean(axis=(1, 3))
    assert np.abs(decode(data, 4) - means).mean() < 1.5


def verdict(data, reduction):
    try:
        decode(data, reduction)
    except DamagedImageError as error:
        return str(error)
    return "undamaged"


@pytest.mark.parametrize("encoding", ["baseline", "progressive", "restart markers"])
def test_damage_is_found_at_every_reduction(encoding):
    data = encode(photo(320, 208), ".jpg", *ENCODINGS[encoding])
    starts = [len(data) * part // 40 for part in range(5, 40)]  # behind the header
    holes = [data[:start] + bytes(500) + data[start + 500 :] for start in starts]
    for reduction in (2, 4):
        assert all(verdict(data[:start], reduction) != "undamaged" for start in starts)
        assert [verdict(hole, reduction) for hole in holes] == [verdict(hole, 1) for hole in holes]
    assert sum(verdict(hole, 4) != "undamaged" for hole in holes) > 20


@pytest.mark.parametrize("reduction", [1, 2])
def test_a_file_with_another_size_than_its_header_is_refused_before_it_is_decoded(monkeypatch, reduction):
    """Reduced by 2, it would have the expected size."""
    data = encode(photo(640, 416), ".jpg")
    monkeypatch.setattr(simplejpeg, "decode_jpeg", lambda *_, **__: pytest.fail("the image was decoded"))
    with pytest.raises(DamagedImageError, match="with a second size of 640x416 px"):
        decode_jpeg(data, ImageHeader(320, 208, 8, 3), reduction)


def test_a_cmyk_file_is_not_reduced():
    inks = np.dstack([PICTURE, PICTURE[..., 0]])
    data = simplejpeg.encode_jpeg(np.ascontiguousarray(inks), colorspace="CMYK", colorsubsampling="444")
    assert np.array_equal(decode(data, 2), opencv_pixels(data))
