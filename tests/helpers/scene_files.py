"""Scene folders with JPEG images, and changed copies of scene folders and bundles."""

import json
import re
import subprocess
from collections.abc import Callable, Iterable
from pathlib import Path

import cv2

from duospacenet.data.scene_writer import write_scene
from duospacenet.runtime import Frame


def copy_tree(source: Path, target: Path) -> Path:
    """Copy a folder; returns the copy."""
    subprocess.run(["cp", "-r", source, target], check=True)
    return target


def front_image(scene: Path, frame: int = 0) -> Path:
    """The image file of the front camera in one frame."""
    record = json.loads((scene / "scene.json").read_text())["frames"][frame]
    return scene / record["cameras"]["CAM_FRONT"]["image"]


def edit_scene(folder: Path, edit: Callable[[dict], object]) -> None:
    """Change the JSON of a scene folder."""
    scene = json.loads((folder / "scene.json").read_text())
    edit(scene)
    (folder / "scene.json").write_text(json.dumps(scene))


def set_focal_length(scene: dict, value: float) -> None:
    """Change the horizontal focal length of the front camera."""
    cameras = scene.get("cameras") or scene["frames"][0]["cameras"]
    cameras["CAM_FRONT"]["intrinsics_px"][0][0] = value


def write_jpeg_scene(folder: Path, frames: Iterable[Frame]) -> Path:
    """Write frames as a scene folder with JPEG images."""
    write_scene(folder, frames)
    for path in (folder / "images").rglob("*.png"):
        cv2.imwrite(str(path.with_suffix(".jpg")), cv2.imread(str(path)))
        path.unlink()
    scene = folder / "scene.json"
    scene.write_text(re.sub(r'(images/[^"]*)\.png', r"\1.jpg", scene.read_text()))
    return folder
