"""The time and the memory for opening a scene folder of 30,000 frames. It has no images.

Usage: python -m benchmarks.scene_folder_scale FOLDER [--frames N]

FOLDER is a new folder for a `scene.json` of 10.8 kB per frame, as of nuScenes' training split, and is removed at the
end. Targets: 3 s, and at most 1 MB for a worker of a training.
"""

import argparse
import json
import multiprocessing
import os
import pickle
import shutil
import time
from pathlib import Path
from typing import Any

import numpy as np

from duospacenet.runtime.cpu import describe_cpu
from duospacenet.runtime.peak_memory import peak_memory_gb
from duospacenet.synthetic.drive import SyntheticDrive

LARGEST_OPEN_S, LARGEST_PICKLE_BYTES = 3, 10**6
BOXES_PER_FRAME = 24
FRAMES_PER_SCENE = 40


def main() -> None:
    parser = argparse.ArgumentParser(description="Time and memory for a scene folder of 30,000 frames.")
    parser.add_argument("folder", type=Path, help="new folder, which is removed at the end")
    parser.add_argument("--frames", type=int, default=30_000)
    options = parser.parse_args()
    print(f"CPU: {describe_cpu()}; load {os.getloadavg()[0]:.1f}")
    options.folder.mkdir(parents=True)
    try:
        size = write_scene_json(options.folder / "scene.json", options.frames)
        print(f"scene.json: {size / 1e6:.0f} MB, {options.frames} frames")
        with multiprocessing.get_context("spawn").Pool(1) as pool:
            pool.apply(open_folder, (options.folder,))
    finally:
        shutil.rmtree(options.folder)


def write_scene_json(path: Path, num_frames: int) -> int:
    """Write frames, each with its calibrations and boxes. Returns the size of the file."""
    rng = np.random.default_rng(0)
    drive = SyntheticDrive(3, 1).frame_without_images(0)
    cameras = {
        name: {
            "width_px": camera.width_px,
            "height_px": camera.height_px,
            "intrinsics_px": camera.intrinsics_px.tolist(),
            "camera_T_ego": camera.camera_T_ego.tolist(),
        }
        for name, camera in drive.cameras.items()
    }
    with path.open("w") as file:
        file.write('{"schema_version": 1, "scene": "scale", "frames": [\n')
        for index in range(num_frames):
            frame = {
                "timestamp_s": 1e9 + 0.5 * index,
                "token": f"{index:032x}",
                "scene": f"scene-{index // FRAMES_PER_SCENE:04d}",
                "global_T_ego": drive.global_T_ego.tolist(),
                "cameras": {
                    name: {"image": f"samples/{name}/n015-2018-07-24__{name}__{index}.jpg", **calibration}
                    for name, calibration in cameras.items()
                },
                "boxes": [_box(rng) for _ in range(BOXES_PER_FRAME)],
            }
            file.write(f"{',' if index else ''}{json.dumps(frame)}\n")
        file.write("]}\n")
    return path.stat().st_size


def open_folder(folder: Path) -> None:
    """Open the folder, and print the figures."""
    start = time.perf_counter()
    from duospacenet.data.scene_folder import SceneFolder

    source = SceneFolder(folder)
    seconds, cpu_s, pickled = time.perf_counter() - start, time.process_time(), len(pickle.dumps(source))
    missed = " ABOVE THE TARGET" if seconds > LARGEST_OPEN_S or pickled > LARGEST_PICKLE_BYTES else ""
    print(f"open: {seconds:.2f} s, {cpu_s:.2f} s of processor time with all imports; {peak_memory_gb():.2f} GB{missed}")
    print(f"pickled: {pickled / 1e6:.2f} MB")
    start = time.perf_counter()
    for index in range(len(source)):
        source.frame_without_images(index)
    print(f"a frame without images: {1000 * (time.perf_counter() - start) / len(source):.2f} ms")


def _box(rng: np.random.Generator) -> dict[str, Any]:
    return {
        "class": "vehicle.car",
        "center_m": rng.normal(0, 20, 3).tolist(),
        "size_wlh_m": rng.uniform(1, 4, 3).tolist(),
        "yaw_rad": float(rng.normal()),
        "velocity_m_s": rng.normal(0, 5, 2).tolist(),
        "num_points": int(rng.integers(9)),
    }


if __name__ == "__main__":
    main()
