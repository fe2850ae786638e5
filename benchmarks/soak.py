"""A long run with every event that a stream must survive: four streams in threads, with sampled checks.

`make soak` runs 10,000 frames of `tiny`; `tests/reliability/test_memory.py` runs fewer. Both use a process of their
own, so that nothing else changes its memory. Each frame may bring a reset, a new scene, a gap, a jump, another
calibration, lost cameras, or a frame that must be refused. Sampled detections are compared, bit for bit, with those of
a fresh stream that was given only the window.
"""

import argparse
import sys
import tempfile
import threading
from collections import Counter, deque
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from duospacenet.runtime import Frame, Pipeline, Stream
from duospacenet.runtime.errors import InputError
from duospacenet.synthetic.drive import SyntheticDrive
from tests.helpers.processes import call
from tests.helpers.streams import TINY_SIZE_PX, bitwise_equal, detect_all, lose_cameras, move_ego, turn_cameras

NUM_STREAMS = 4
LARGEST_SLOPE_KB = 0.5  # memory growth per frame
SAMPLED = 0.02  # share of frames that are compared
WARM_UP = 0.3  # share of frames before memory is measured: pools and arenas first grow to their size

# Events and their probability per frame.
EVENTS = {
    "reset": 0.02,
    "new scene": 0.02,
    "dropped frames": 0.05,
    "gap": 0.02,
    "ego jump": 0.02,
    "other calibration": 0.03,
    "lost cameras": 0.1,
    "every camera lost": 0.01,
    "duplicate": 0.02,
    "NaN in the pose": 0.02,
}


@dataclass
class Figures:
    """Result of a soak. memory_kb: pairs of frames so far and resident memory; compared, mismatches: sampled frames."""

    frames: int = 0
    events: Counter[str] = field(default_factory=Counter)
    resets: Counter[str] = field(default_factory=Counter)
    compared: int = 0
    mismatches: int = 0
    memory_kb: list[tuple[int, float]] = field(default_factory=list)

    @property
    def slope_kb(self) -> float:
        """Memory growth per frame after the warm-up: the slope of a least-squares line."""
        total = self.memory_kb[-1][0]
        x, y = np.array([entry for entry in self.memory_kb if entry[0] > WARM_UP * total], dtype=float).T
        return float(np.polyfit(x, y, 1)[0])


def soak(pipeline: Pipeline, num_frames: int, leak_bytes: int = 0, in_turn: bool = False) -> Figures:
    """Run `num_frames` frames over all streams.

    leak_bytes: bytes leaked per frame, for a control that must fail.
    in_turn: step the streams in turn in one thread. The number of frames in progress, and with it the size of pools
        and arenas, is then constant.
    """
    figures, lock, leak = Figures(), threading.Lock(), []
    pool = [list(SyntheticDrive(seed, frames=5, image_size=TINY_SIZE_PX)) for seed in range(NUM_STREAMS)]

    def count(journey: "Journey") -> None:
        with lock:
            figures.frames += 1
            if leak_bytes:
                leak.append(bytearray(leak_bytes))
            if figures.frames % max(1, num_frames // 200) == 0:
                figures.memory_kb.append((figures.frames, resident_kb()))

    journeys = [Journey(pipeline, frames, seed, count) for seed, frames in enumerate(pool)]
    steps = [journey.drive(num_frames // NUM_STREAMS) for journey in journeys]
    if in_turn:
        exhaust(zip(*steps, strict=True))
    else:
        with ThreadPoolExecutor(NUM_STREAMS) as threads:
            list(threads.map(exhaust, steps))
    for journey in journeys:
        figures.events += journey.events
        figures.resets += journey.resets
        figures.compared += journey.compared
        figures.mismatches += journey.mismatches
    return figures


class Journey:
    """One stream with its own seed, and the frames that its next detections may depend on."""

    def __init__(self, pipeline: Pipeline, frames: list[Frame], seed: int, count) -> None:
        self._pipeline, self._frames, self._count = pipeline, frames, count
        self._rng = np.random.default_rng(seed)
        self._stream: Stream = pipeline.stream(maps=True)
        self._window: deque[Frame] = deque(maxlen=pipeline.manifest.window.num_frames)
        self._scene, self._time_s, self._turned = 0, 1e9, False
        self.events: Counter[str] = Counter()
        self.resets: Counter[str] = Counter()
        self.compared = self.mismatches = 0

    def drive(self, num_frames: int) -> Iterator[None]:
        """Step by one frame per iteration."""
        for number in range(num_frames):
            events = [event for event, share in EVENTS.items() if self._rng.random() < share]
            self.events.update(events)
            self._step(self._next(number, events), events)
            self._count(self)
            yield

    def _next(self, number: int, events: list[str]) -> Frame:
        """The next frame of the pool at its time and pose, with its events applied."""
        self._scene += "new scene" in events
        self._turned ^= "other calibration" in events
        self._time_s += 0.5 + 0.6 * ("dropped frames" in events) + 5 * ("gap" in events)
        if "reset" in events:
            self._stream.reset()
            self._window.clear()
        frame = self._frames[number % len(self._frames)]
        frame = move_ego(replace(frame, timestamp_s=self._time_s, scene=f"scene {self._scene}"), 0.0)
        if "ego jump" in events:
            frame = move_ego(frame, 1e4)
        if self._turned:
            frame = turn_cameras(frame)
        if "lost cameras" in events:
            names = list(frame.cameras)
            frame = lose_cameras(frame, *self._rng.choice(names, self._rng.integers(1, len(names)), replace=False))
        return lose_cameras(frame, *frame.cameras) if "every camera lost" in events else frame

    def _step(self, frame: Frame, events: list[str]) -> None:
        if "NaN in the pose" in events:
            self._refuse(replace(frame, global_T_ego=np.full((4, 4), np.nan)))
        detections = self._stream.step(frame)
        if detections.skipped:
            return
        if detections.history.reset_reason:
            self.resets[detections.history.reset_reason.split(" ")[0]] += 1
            self._window.clear()
        self._window.append(frame)
        if "duplicate" in events:
            self._refuse(frame)
        if self._rng.random() < SAMPLED:
            self.compared += 1
            self.mismatches += not bitwise_equal(detections, detect_all(self._pipeline, self._window, maps=True)[-1])

    def _refuse(self, frame: Frame) -> None:
        try:
            self._stream.step(frame)
        except InputError:
            return
        self.mismatches += 1


def exhaust(steps: Iterator) -> None:
    """Run an iterator to its end."""
    deque(steps, maxlen=0)


def resident_kb() -> float:
    """Resident memory of this process [KiB]."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * 4


def print_figures(figures: Figures, largest_slope_kb: float) -> bool:
    """Print the result of a soak. Returns whether it passed."""
    print(f"{figures.frames} frames in {NUM_STREAMS} streams")
    print("events   ", ", ".join(f"{event} {number}" for event, number in sorted(figures.events.items())))
    print("resets   ", ", ".join(f"reset by {reason} {number}" for reason, number in sorted(figures.resets.items())))
    print(f"sampled   {figures.compared} compared with a fresh stream, {figures.mismatches} differ")
    print(f"memory    {figures.memory_kb[-1][1] / 1024:.1f} MB, {figures.slope_kb:+.3f} KB per frame")
    return figures.mismatches == 0 and figures.slope_kb <= largest_slope_kb


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--frames", type=int, default=10_000)
    parser.add_argument("--bundle", type=Path, help="bundle of the tiny preset; default: export one")
    parser.add_argument("--largest-slope-kb", type=float, default=LARGEST_SLOPE_KB, help="memory growth per frame")
    parser.add_argument("--leak-bytes", type=int, default=0, help="leak this much per frame, as a control")
    parser.add_argument("--in-turn", action="store_true", help="step the streams in turn, in one thread")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        bundle = options.bundle or export(Path(folder) / "bundle")
        figures = soak(Pipeline.load(bundle), options.frames, options.leak_bytes, options.in_turn)
    return 0 if print_figures(figures, options.largest_slope_kb) else 1


def export(out: Path) -> Path:
    """Export `tiny` with random weights in another process, so that torch does not count in the memory."""
    call(["export", "--preset", "tiny", "--random-weights", "--out", out], check=True)
    return out


if __name__ == "__main__":
    sys.exit(main())
