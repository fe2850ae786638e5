"""Changed copies of scene folders and bundles."""

import json
import subprocess
from collections.abc import Callable
from pathlib import Path


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
