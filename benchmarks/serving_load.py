"""Load on a Triton server on this machine: latencies for several vehicles, and what a dead client costs.

    python -m benchmarks.serving_load BUNDLE OUT

Server and clients share the cores, and talk over 127.0.0.1. The cameras send JPEG files of 1600x900 pixels.
"""

import argparse
import json
import os
import re
import subprocess
import time
from pathlib import Path

import cv2
import numpy as np

from duospacenet.data.scene_folder import SceneFolder
from duospacenet.data.scene_writer import write_scene
from duospacenet.jobs import package_triton
from duospacenet.jobs.serving.serving_options import ServingOptions
from duospacenet.runtime import Pipeline
from duospacenet.runtime.cpu import read_cpu
from duospacenet.synthetic.drive import SyntheticDrive
from tests.helpers.process_tree import child_processes
from tests.helpers.pytriton import RunningServer, run_client, running_triton, triton_python

CLIENT = Path(__file__).with_name("serving_client.py")
PLACES = 8
RATE_HZ = 2.0  # of nuScenes' key frames
FRAMES = 16  # of each vehicle
SCENE_FRAMES = 8
IMAGE_SIZE_PX = (1600, 900)
JPEG_QUALITY = 90
IDLE_S = 20.0


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description="Measure a Triton server under load.")
    parser.add_argument("bundle", type=Path)
    parser.add_argument("out", type=Path, help="new folder")
    parser.add_argument("--instances", type=int, default=1)
    parser.add_argument("--vehicles", type=int, nargs="+", default=[1, 4, 8])
    parser.add_argument("--rates", type=float, nargs="+", default=[RATE_HZ, 0.0], help="0: as many frames as possible")
    arguments = parser.parse_args()
    out: Path = arguments.out
    scene = _write_jpeg_scene(out / "scene")
    options = ServingOptions(vehicles=PLACES, idle_s=IDLE_S, instances=arguments.instances)
    package_triton(arguments.bundle, out / "models", options)
    cpu = read_cpu()
    print(f"{cpu.model}, {cpu.cores} cores, load of the machine before the start: {os.getloadavg()[0]:.1f}")
    with running_triton(out / "models", out / "server.log") as server:
        _measure(server, scene, 1, rate=0.0)  # the first runs of the graphs are slower
        print(
            "| vehicles | frames of each per second | p50 [ms] | p99 [ms] | frames per second | server's memory [MB] |"
        )
        print("| --- | --- | --- | --- | --- | --- |")
        _measure_without_server(arguments.bundle, scene)
        for rate in arguments.rates:
            for vehicles in arguments.vehicles:
                _measure(server, scene, vehicles, rate, show=True)
        _measure_dead_clients(server, scene)


def _measure(server: RunningServer, scene: Path, vehicles: int, rate: float, show: bool = False) -> None:
    options = ["--vehicles", vehicles, "--frames", FRAMES, "--rate", rate]
    done = run_client(CLIENT, ["drive", server.url, scene, *options], timeout_s=600)
    assert done.returncode == 0, done.stderr
    measured = json.loads(done.stdout)
    throughput = len(measured["latencies_s"]) / measured["duration_s"]
    if show:
        pace = f"{rate:g}" if rate else "as many as possible"
        _print_row(str(vehicles), pace, measured["latencies_s"], throughput, f"{_memory_mb(server):.0f}")


def _measure_without_server(bundle: Path, scene: Path) -> None:
    """The same frames in a stream of this process, image files included."""
    pipeline, latencies_s = Pipeline.load(bundle), []
    for _ in range(FRAMES // SCENE_FRAMES):
        stream, source = pipeline.stream(), SceneFolder(scene)
        for index in range(SCENE_FRAMES):
            start_s = time.perf_counter()
            stream.step(source.frame(index), maps=True)
            latencies_s.append(time.perf_counter() - start_s)
    _print_row("1, without a server", "as many as possible", latencies_s, 1 / float(np.mean(latencies_s)), "")


def _print_row(vehicles: str, pace: str, latencies_s: list[float], throughput: float, memory: str) -> None:
    p50_ms, p99_ms = np.percentile(latencies_s, [50, 99]) * 1e3
    print(f"| {vehicles} | {pace} | {p50_ms:.0f} | {p99_ms:.0f} | {throughput:.1f} | {memory} |")


def _measure_dead_clients(server: RunningServer, scene: Path) -> None:
    """Take every place, kill the clients, and measure how long a new vehicle waits."""
    command = [str(triton_python()), str(CLIENT), "hold", server.url, str(scene)]
    clients = [subprocess.Popen(command, stdout=subprocess.PIPE, text=True) for _ in range(PLACES)]
    try:
        for client in clients:
            assert client.stdout is not None and client.stdout.readline(), "a client got no place"
    finally:
        for client in clients:
            client.kill()
            client.wait()
    killed_s = time.perf_counter()
    done = run_client(CLIENT, ["wait", server.url, scene], timeout_s=120)
    assert done.returncode == 0, done.stderr
    waited_s = time.perf_counter() - killed_s
    print(
        f"{len(clients)} clients were killed in the middle of their sequences; the next vehicle had its first result "
        f"after {waited_s:.1f} s (idle time {IDLE_S:g} s). Server's memory: {_memory_mb(server):.0f} MB."
    )


def _write_jpeg_scene(folder: Path) -> Path:
    """Write a short drive as a scene folder with JPEG images, if it does not exist. Returns `folder`."""
    if folder.exists():
        return folder
    write_scene(folder, SyntheticDrive(1, frames=SCENE_FRAMES, image_size=IMAGE_SIZE_PX))
    for path in folder.rglob("images/**/*.png"):
        image = cv2.imread(str(path))
        assert image is not None
        cv2.imwrite(str(path.with_suffix(".jpg")), image, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
        path.unlink()
    scene = folder / "scene.json"
    scene.write_text(re.sub(r'("images/[^"]*)\.png"', r'\1.jpg"', scene.read_text()))
    return folder


def _memory_mb(server: RunningServer) -> float:
    """Resident memory of the server and the processes that it started [MB]."""
    pids = [server.process.pid]
    for pid in pids:  # grows while it is read
        pids += child_processes(pid)
    pages = sum(int(Path(f"/proc/{pid}/statm").read_text().split()[1]) for pid in pids)
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


if __name__ == "__main__":
    main()
