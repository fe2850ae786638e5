"""Vehicles as clients of a Triton server, for `benchmarks.serving_load`. Runs where tritonclient is installed.

    python serving_client.py drive URL SCENE --vehicles 4 --frames 40 --rate 2

prints the latencies of all frames as JSON. `hold` starts a sequence and waits to be killed; `wait` starts one and
prints how long it took to get a place.
"""

import argparse
import json
import sys
import time
import uuid
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from duospacenet.jobs.serving.check_sequences import Server, Tensors, read_scene

MODEL = "duospacenet"


def main() -> None:
    """Run one of the three modes."""
    parser = argparse.ArgumentParser(description="Vehicles as clients of a server.")
    parser.add_argument("mode", choices=["drive", "hold", "wait"])
    parser.add_argument("url")
    parser.add_argument("scene", type=Path)
    parser.add_argument("--vehicles", type=int, default=1)
    parser.add_argument("--frames", type=int, default=40, help="of each vehicle")
    parser.add_argument("--rate", type=float, default=0.0, help="frames per second of each vehicle; 0: without pause")
    arguments = parser.parse_args()
    frames = list(read_scene(arguments.scene))
    if arguments.mode == "drive":
        _drive_all(arguments.url, frames, arguments.vehicles, arguments.frames, arguments.rate)
    else:
        start_s = time.perf_counter()
        Server(arguments.url, MODEL).send(frames[0], uuid.uuid4().hex, start=True, end=arguments.mode == "wait")
        print(time.perf_counter() - start_s, flush=True)
        time.sleep(600 if arguments.mode == "hold" else 0)


def _drive_all(url: str, frames: list[Tensors], vehicles: int, num_frames: int, rate: float) -> None:
    start_s = time.perf_counter()
    with ThreadPoolExecutor(vehicles) as pool:
        offsets_s = [vehicle / (rate * vehicles) if rate else 0.0 for vehicle in range(vehicles)]
        drives = [pool.submit(_drive, url, frames, num_frames, rate, offset_s) for offset_s in offsets_s]
        latencies_s = [latency_s for drive in drives for latency_s in drive.result()]
    print(json.dumps({"latencies_s": latencies_s, "duration_s": time.perf_counter() - start_s}))


def _drive(url: str, frames: list[Tensors], num_frames: int, rate: float, offset_s: float) -> list[float]:
    """Send frames one after the other, and return the time from each frame to its answer [s].

    With a rate, a frame whose time has come before the answer to the last one waits for it, and this wait counts.
    """
    server, sequence, latencies_s = Server(url, MODEL), "", []
    start_s = time.perf_counter() + offset_s
    for index in range(num_frames):
        due_s = start_s + index / rate if rate else time.perf_counter()
        time.sleep(max(0.0, due_s - time.perf_counter()))
        place = index % len(frames)  # the drive is repeated, each time as a new sequence
        sequence = uuid.uuid4().hex if place == 0 else sequence
        ends = place == len(frames) - 1 or index == num_frames - 1
        server.send(frames[place], sequence, start=place == 0, end=ends)
        latencies_s.append(time.perf_counter() - due_s)
    return latencies_s


if __name__ == "__main__":
    sys.exit(main())
