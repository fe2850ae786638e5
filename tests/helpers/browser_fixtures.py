"""Files for the tests of the browser consumer: what Python and OpenCV compute from the same inputs.

    python -m tests.helpers.browser_fixtures BUNDLE INT8_BUNDLE FOLDER

writes the folder that the tests in consumers/browser/tests read by the variable DUOSPACENET_FIXTURES.
"""

import json
import sys
import zlib
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from duospacenet.data.images import read_image
from duospacenet.runtime import Camera, Frame
from duospacenet.runtime.bundle.manifest import Preprocessing, read_manifest
from duospacenet.runtime.preprocessing import prepare
from tests.helpers.consumer_drive import write_consumer_drive, write_python_results
from tests.helpers.image_files import encode, png_file, png_header_chunk

WIDTH, HEIGHT = 45, 31  # odd, so that rows of a few bits end within a byte
ADAM7 = ((0, 0, 8, 8), (4, 0, 8, 8), (0, 4, 4, 8), (2, 0, 4, 4), (0, 2, 2, 4), (1, 0, 2, 2), (0, 1, 1, 2))  # x y dx dy


def write_browser_fixtures(bundle: Path, int8_bundle: Path, folder: Path) -> Path:
    """Write all files. Returns `folder`."""
    folder.mkdir(parents=True)
    (folder / "bundle").symlink_to(bundle.resolve())
    (folder / "int8").symlink_to(int8_bundle.resolve())
    scene = write_consumer_drive(bundle, folder / "drive")
    write_python_results(bundle, scene, folder / "results.jsonl")
    write_python_results(int8_bundle, scene, folder / "int8_results.jsonl")
    _write_resized(folder / "pixels", read_manifest(bundle).preprocessing)
    _write_images(folder / "images")
    return folder


def _write_resized(folder: Path, preprocessing: Preprocessing) -> None:
    """Write random images, and the network's images that `prepare` makes of them."""
    folder.mkdir()
    rng = np.random.default_rng(0)
    sizes = [(320, 128), (640, 256), (640, 400), (160, 64), (80, 32), (100, 90), (481, 200), (480, 192), (161, 64)]
    sizes += [tuple(rng.integers(20, 500, 2).tolist()) for _ in range(24)]
    cases = []
    for shrinking in ("area by halvings", "area"):
        method = preprocessing.model_copy(update={"resize_shrinking": shrinking})
        for width, height in sizes:
            image = rng.integers(0, 256, (height, width, 3), np.uint8)
            (folder / f"{len(cases)}.in").write_bytes(image.tobytes())
            (folder / f"{len(cases)}.out").write_bytes(_prepared(image, method).tobytes())
            cases.append({"width": width, "height": height, "preprocessing": method.model_dump(mode="json")})
    (folder / "cases.json").write_text(json.dumps({"cases": cases}))


def _prepared(image: NDArray[np.uint8], preprocessing: Preprocessing) -> NDArray[np.uint8]:
    camera = Camera(np.diag([500.0, 500.0, 1.0]), np.eye(4), image.shape[1], image.shape[0])
    frame = Frame({"front": image}, {"front": camera}, np.eye(4), 0.0)
    return prepare(frame, preprocessing, 1).images[0]


def _write_images(folder: Path) -> None:
    """Write image files of every kind with their pixels, and files that are refused with the end of the message."""
    folder.mkdir()
    rng = np.random.default_rng(1)
    image = cv2.GaussianBlur(rng.integers(0, 256, (HEIGHT, WIDTH, 3), np.uint8), (5, 5), 1.5)
    valid = {**dict(_jpeg_files(image)), **dict(_png_files(image, rng))}
    refused = dict(_refused_files(image, valid["colour.png"], valid["colour.jpg"]))
    for name, content in valid.items():
        (folder / name).write_bytes(content)
        pixels = read_image(folder / name, WIDTH, HEIGHT)
        (folder / f"{name}.bgr").write_bytes(pixels.tobytes())
    for name, (content, _) in refused.items():
        (folder / name).write_bytes(content)
    messages = {name: message for name, (_, message) in refused.items()}
    (folder / "list.json").write_text(json.dumps({"valid": list(valid), "refused": messages}))


def _jpeg_files(image: NDArray[np.uint8]) -> Iterator[tuple[str, bytes]]:
    samplings = {"colour": 0x221111, "wide": 0x211111, "full": 0x111111, "high": 0x121111}
    for name, sampling in samplings.items():
        yield f"{name}.jpg", encode(image, ".jpg", cv2.IMWRITE_JPEG_SAMPLING_FACTOR, sampling)
    yield "progressive.jpg", encode(image, ".jpg", cv2.IMWRITE_JPEG_PROGRESSIVE, 1)
    yield "restarts.jpg", encode(image, ".jpg", cv2.IMWRITE_JPEG_RST_INTERVAL, 2)
    yield "grey.jpg", encode(image[..., 0], ".jpg")
    yield "trailing.jpg", encode(image, ".jpg") + b"trailing bytes"


def _png_files(image: NDArray[np.uint8], rng: np.random.Generator) -> Iterator[tuple[str, bytes]]:
    alpha = rng.integers(0, 256, (HEIGHT, WIDTH, 1), np.uint8)
    palette = b"PLTE", rng.integers(0, 256, 3 * 16, np.uint8).tobytes()
    yield "colour.png", encode(image, ".png")
    yield "transparent.png", encode(np.concatenate((image, alpha), axis=2), ".png")
    yield "trailing.png", encode(image, ".png") + b"trailing bytes"
    for bits in (1, 2, 4, 8):
        values = rng.integers(0, 2**bits, (HEIGHT, WIDTH), np.uint8)
        rows = _packed_rows(values, bits)
        yield f"grey_{bits}.png", png_file(png_header_chunk(WIDTH, HEIGHT, bits, 0), (b"IDAT", zlib.compress(rows)))
        rows = _packed_rows(values % 16, bits)
        header = png_header_chunk(WIDTH, HEIGHT, bits, 3)
        yield f"palette_{bits}.png", png_file(header, palette, (b"IDAT", zlib.compress(rows)))
    interlaced = b"".join(
        _packed_rows(image[y::dy, x::dx, ::-1].reshape(-1, 3 * len(range(x, WIDTH, dx))), 8) for x, y, dx, dy in ADAM7
    )
    yield "interlaced.png", png_file(png_header_chunk(WIDTH, HEIGHT, interlace=1), (b"IDAT", zlib.compress(interlaced)))
    # A gamma would change colours in a browser.
    start = encode(image, ".png")
    yield "gamma.png", start[:33] + png_file((b"gAMA", (20_000).to_bytes(4)))[8:-12] + start[33:]


def _packed_rows(values: NDArray[np.uint8], bits: int) -> bytes:
    """Rows of a PNG file without a filter: values of a few bits, the first in the highest bits."""
    unpacked = np.unpackbits(values[..., None], axis=-1)[..., -bits:].reshape(len(values), -1)
    rows = np.packbits(unpacked, axis=1)
    return b"".join(b"\0" + row.tobytes() for row in rows)


def _refused_files(image: NDArray[np.uint8], png: bytes, jpeg: bytes) -> Iterator[tuple[str, tuple[bytes, str]]]:
    wrong = bytearray(png)
    wrong[60] ^= 1
    yield "empty.png", (b"", "an empty file")
    yield "text.png", (b"version https://git-lfs.github.com/spec/v1\n", "a git-lfs pointer")
    yield "other.jpg", (encode(image, ".webp"), "a WebP image")
    yield "deep.png", (encode(image.astype(np.uint16) * 256, ".png"), "found 16")
    yield "small.png", (encode(image[:-1], ".png"), f"found {WIDTH}x{HEIGHT - 1} px")
    yield "flipped.png", (bytes(wrong), "an undamaged image")
    yield "unfinished.jpg", (jpeg[:-40], "libjpeg reports damage")
    yield "header_only.png", (png[:20], "an image without its header")
    yield "four_colours.jpg", (_cmyk_jpeg(jpeg), "a CMYK file")


def _cmyk_jpeg(jpeg: bytes) -> bytes:
    """A JPEG file whose header says that it has four colours."""
    start = jpeg.index(b"\xff\xc0")
    return jpeg[: start + 9] + b"\x04" + jpeg[start + 10 :]


if __name__ == "__main__":
    write_browser_fixtures(*(Path(argument) for argument in sys.argv[1:4]))
