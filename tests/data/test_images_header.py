"""Checks of image files by their headers: what is refused before any pixel is decoded, and what is not read."""

import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

from duospacenet.data.images import check_image_header, check_mask_header
from duospacenet.data.scene_folder import SceneFolder
from duospacenet.data.scene_writer import write_scene
from duospacenet.runtime.errors import InputError
from duospacenet.runtime.files import START_BYTES
from duospacenet.synthetic.drive import SyntheticDrive
from tests.helpers.scene_files import edit_scene, front_image
from tests.helpers.streams import TINY_SIZE_PX

IMAGE = np.random.default_rng(0).integers(0, 255, (200, 300, 3), np.uint8)


def write(path: Path, image: np.ndarray = IMAGE) -> Path:
    cv2.imwrite(str(path), image)
    return path


@pytest.mark.parametrize("name", ["a.png", "a.jpg"])
def test_only_the_start_of_a_file_is_read(tmp_path, monkeypatch, name):
    path = write(tmp_path / name)
    sizes, read_regular_file = [], check_image_header.__globals__["read_regular_file"]

    def measured(*arguments):
        data = read_regular_file(*arguments)
        sizes.append(len(data))
        return data

    monkeypatch.setitem(check_image_header.__globals__, "read_regular_file", measured)
    path.write_bytes(path.read_bytes() + bytes(10 * START_BYTES))
    check_image_header(path, 300, 200)
    assert sizes == [START_BYTES]


def test_a_header_behind_long_metadata_is_found(tmp_path):
    """Several EXIF segments of 64 KB come before the size."""
    path = write(tmp_path / "a.jpg")
    content = path.read_bytes()
    segment = b"\xff\xe1" + (65000).to_bytes(2) + bytes(64998)
    path.write_bytes(content[:2] + 3 * segment + content[2:])
    check_image_header(path, 300, 200)
    with pytest.raises(InputError, match=r"a\.jpg: expected 301x200 px"):
        check_image_header(path, 301, 200)


REFUSED = {
    "missing": (Path.unlink, "expected an image file; got no such file"),
    "empty": (lambda path: path.write_bytes(b""), "got an empty file"),
    "text": (lambda path: path.write_text("version https://git-lfs"), "git-lfs pointer"),
    "a folder": (lambda path: (path.unlink(), path.mkdir()), "expected a regular file; got a folder"),
    "another size": (lambda path: write(path, IMAGE[:100]), "expected 300x200 px, .* got 300x100 px"),
    "16 bits": (lambda path: write(path, IMAGE.astype(np.uint16)), "expected 8 bits per channel; got 16"),
}


@pytest.mark.parametrize("kind", REFUSED)
def test_a_file_that_cannot_be_right_is_refused(tmp_path, kind):
    change, words = REFUSED[kind]
    path = write(tmp_path / "a.png")
    change(path)
    with pytest.raises(InputError, match=words):
        check_image_header(path, 300, 200)


def test_a_mask_must_be_a_png_file(tmp_path):
    check_mask_header(write(tmp_path / "a.png"))
    with pytest.raises(InputError, match="expected a mask as a PNG file; got a JPEG file"):
        check_mask_header(write(tmp_path / "a.jpg"))


def test_a_scene_folder_checks_its_images_and_masks_and_names_lost_cameras(tmp_path):
    write_scene(tmp_path / "scene", SyntheticDrive(5, frames=2, image_size=TINY_SIZE_PX))
    edit_scene(
        tmp_path / "scene",
        lambda record: record["frames"][1]["cameras"]["CAM_BACK"].update(image=None),
    )
    source = SceneFolder(tmp_path / "scene")
    assert source.check_image_files(0) == ()
    assert source.check_image_files(1) == ("CAM_BACK",)
    image = front_image(tmp_path / "scene", 1)
    shutil.move(image, tmp_path / "moved.png")
    with pytest.raises(InputError, match=f"{image.name}: expected an image file"):
        source.check_image_files(1)
    assert source.check_image_files(0) == ()
    shutil.rmtree(tmp_path / "scene" / "maps")
    with pytest.raises(InputError, match=r"maps/.*: expected an image file"):
        source.check_image_files(0)
