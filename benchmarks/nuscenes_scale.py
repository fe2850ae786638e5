"""The time and the memory for a nuScenes root of the size of v1.0-trainval. Its rows are generated; it has no images.

Usage: python -m benchmarks.nuscenes_scale FOLDER [--scale S]

FOLDER is a new folder for the tables (2.9 GB) and the index. It is removed at the end. Each figure is measured in a
separate process. Targets: building the index takes at most 5 minutes and 4 GB of memory. Opening it takes at most 2 s.
A training worker receives at most 1 MB. --scale 0.1 generates a tenth of the scenes.
"""

import argparse
import json
import multiprocessing
import os
import pickle
import shutil
import time
from collections.abc import Callable
from pathlib import Path

from benchmarks.trainval_tables import write_trainval_tables
from duospacenet.runtime.cpu import describe_cpu
from duospacenet.runtime.peak_memory import peak_memory_gb

LARGEST_BUILD_S, LARGEST_BUILD_GB, LARGEST_OPEN_S, LARGEST_PICKLE_BYTES = 300, 4, 2, 10**6
VERSION = "v1.0-trainval"

Figures = dict[str, float]


def main() -> None:
    parser = argparse.ArgumentParser(description="Time and memory for a nuScenes root of trainval's size.")
    parser.add_argument("folder", type=Path, help="new folder, which is removed at the end")
    parser.add_argument("--scale", type=float, default=1.0, help="share of the scenes (default: all)")
    options = parser.parse_args()
    print(f"CPU: {describe_cpu()}; load {os.getloadavg()[0]:.1f}")
    try:
        start = time.perf_counter()
        write_trainval_tables(options.folder / VERSION, options.scale)
        tables = sum(path.stat().st_size for path in options.folder.rglob("*.json"))
        print(f"tables: {tables / 1e9:.2f} GB, generated in {time.perf_counter() - start:.0f} s")
        os.environ["DUOSPACENET_CACHE"] = str(options.folder / "cache")
        source = f"nuscenes:{options.folder}"
        print(f"build:  {_describe(_in_own_process(build, source))}")
        index = sum(path.stat().st_size for path in (options.folder / "cache").rglob("*.npz"))
        print(f"index:  {index / 1e6:.0f} MB")
        print(f"open:   {_describe(_in_own_process(open_again, source))}")
        print(f"use:    {_describe(_in_own_process(use, source))}")
    finally:
        shutil.rmtree(options.folder, ignore_errors=True)


def build(source: str) -> Figures:
    """Build the index."""
    from duospacenet.jobs.sources import open_source

    start = time.perf_counter()
    frames = len(open_source(source))
    seconds, gigabytes = time.perf_counter() - start, peak_memory_gb()
    _warn(seconds > LARGEST_BUILD_S or gigabytes > LARGEST_BUILD_GB)
    return {"s": seconds, "GB peak memory": gigabytes, "frames": frames}


def open_again(source: str) -> Figures:
    """Open the root, with all imports, and pickle it for a worker."""
    start = time.perf_counter()
    from duospacenet.jobs.sources import open_source

    opened = open_source(f"{source}/train")
    seconds, pickled = time.perf_counter() - start, len(pickle.dumps(opened))
    _warn(seconds > LARGEST_OPEN_S or pickled > LARGEST_PICKLE_BYTES)
    return {"s": seconds, "bytes pickled": pickled, "GB peak memory": peak_memory_gb(), "frames": len(opened)}


def use(source: str) -> Figures:
    """Read all frames without their images, and all boxes."""
    from duospacenet.jobs.sources import open_source

    opened = open_source(source)
    start = time.perf_counter()
    for index in range(len(opened)):
        opened.frame_without_images(index)
    frames_s = time.perf_counter() - start
    start = time.perf_counter()
    num_boxes = 0
    for index in range(len(opened)):
        truth = opened.ground_truth_without_maps(index)
        num_boxes += 0 if truth is None else len(truth.boxes)
    boxes_s = time.perf_counter() - start
    return {
        "ms per frame": 1000 * frames_s / len(opened),
        "ms per ground truth": 1000 * boxes_s / len(opened),
        "boxes": num_boxes,
        "GB peak memory": peak_memory_gb(),
    }


def _in_own_process(measure: Callable[[str], Figures], source: str) -> Figures:
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        return pool.apply(measure, (source,))


def _describe(figures: Figures) -> str:
    return ", ".join(f"{json.dumps(round(value, 2))} {unit}" for unit, value in figures.items())


def _warn(is_missed: bool) -> None:
    if is_missed:
        print("above the target:")


if __name__ == "__main__":
    main()
