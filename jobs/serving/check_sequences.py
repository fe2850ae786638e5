"""Checks a running server: are the sequences of several vehicles kept apart, and what ends or refuses them?

    pip install 'tritonclient[grpc]'
    python check_sequences.py --url localhost:8001

Needs numpy and tritonclient, not the toolkit. The frames are those of the bundle's golden scene, or of `--scene`.
Prints one line per check, and ends with exit code 1 if one fails.
"""

import argparse
import json
import math
import sys
import time
import uuid
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import tritonclient.grpc as triton  # pyright: ignore[reportMissingImports]
from tritonclient.utils import InferenceServerException  # pyright: ignore[reportMissingImports]

GOLDEN_SCENE = "*/1/bundle/golden/scene"
TIMEOUT_S = 300.0
IMPATIENT_US = 500_000  # how long a sequence may wait for a place

Outputs = dict[str, np.ndarray]
Tensors = dict[str, np.ndarray]


class CheckFailed(Exception):
    """A server did something else than expected."""


class Server:
    """A model on a server, and what its configuration says."""

    def __init__(self, url: str, model: str) -> None:
        self._client, self.model = triton.InferenceServerClient(url), model
        config = self._client.get_model_config(model, as_json=True)["config"]
        batching = config["sequence_batching"]
        instances = sum(int(group.get("count", 1)) for group in config["instance_group"])
        self.num_places = int(batching["oldest"]["max_candidate_sequences"]) * instances
        self.idle_s = float(batching["max_sequence_idle_microseconds"]) / 1e6
        self.outputs = [output["name"] for output in config["output"]]
        self.classes: list[str] = json.loads(config["parameters"]["classes"]["string_value"])

    def send(
        self, tensors: Tensors, sequence: str, start: bool = False, end: bool = False, wait_us: int = 0
    ) -> Outputs:
        """Send one frame and return the outputs. Raises InferenceServerException for an error of the server."""
        inputs = []
        for name, array in tensors.items():
            dtype = {"O": "BYTES", "f": "FP64", "i": "INT32"}[array.dtype.kind]
            inputs.append(triton.InferInput(name, list(array.shape), dtype))
            inputs[-1].set_data_from_numpy(array)
        flags: dict[str, Any] = {"sequence_id": sequence, "sequence_start": start, "sequence_end": end}
        options = {"timeout": wait_us or None, "client_timeout": TIMEOUT_S}
        result = self._client.infer(self.model, inputs, **flags, **options)
        return {name: result.as_numpy(name) for name in self.outputs}


class Vehicle:
    """The frames of a scene, sent as one sequence."""

    def __init__(self, server: Server, frames: Sequence[Tensors]) -> None:
        self._server, self._frames, self._next = server, frames, 0
        self.sequence = f"check-{uuid.uuid4().hex[:12]}"

    def step(self, **options: Any) -> Outputs:
        """Send the next frame."""
        index, last = self._next, len(self._frames) - 1
        outputs = self._server.send(self._frames[index], self.sequence, start=index == 0, end=index == last, **options)
        self._next += 1
        return outputs

    def drive(self) -> list[Outputs]:
        """Send all frames that are left."""
        return [self.step() for _ in range(self._next, len(self._frames))]


def read_scene(folder: Path) -> Iterator[Tensors]:
    """Yield the inputs of each frame of a scene folder, see docs/scene-folder.md."""
    scene = json.loads((folder / "scene.json").read_text())
    for frame in scene["frames"]:
        shared = scene.get("cameras") or {}
        in_frame = frame["cameras"]
        names = [*shared, *(name for name in in_frame if name not in shared)]
        cameras = [
            {"image": None} | shared.get(name, {}) | {k: v for k, v in in_frame.get(name, {}).items() if v is not None}
            for name in names
        ]
        images = [(folder / camera["image"]).read_bytes() if camera["image"] else b"" for camera in cameras]
        yield {
            "timestamp_s": np.array([frame["timestamp_s"]], np.float64),
            "global_T_ego": np.array(frame["global_T_ego"], np.float64),
            "camera_names": np.array([name.encode() for name in names], dtype=object),
            "images": np.array(images, dtype=object),
            "size_px": np.array([[camera["width_px"], camera["height_px"]] for camera in cameras], np.int32),
            "intrinsics_px": np.array([camera["intrinsics_px"] for camera in cameras], np.float64),
            "camera_T_ego": np.array([camera["camera_T_ego"] for camera in cameras], np.float64),
            "scene": np.array([(frame.get("scene") or scene["scene"]).encode()], dtype=object),
        }


def check_interleaved(server: Server, frames: Sequence[Tensors], alone: Sequence[Outputs]) -> None:
    """Two vehicles whose frames alternate give the outputs of one vehicle alone, bit for bit."""
    first, second = Vehicle(server, frames), Vehicle(server, frames)
    results: tuple[list[Outputs], list[Outputs]] = ([first.step()], [])
    for _ in frames[1:]:  # the second vehicle is one frame behind
        results[1].append(second.step())
        results[0].append(first.step())
    results[1].append(second.step())
    for vehicle, outputs in enumerate(results):
        _expect_equal(f"vehicle {vehicle}", outputs, alone)


def check_start(server: Server, frames: Sequence[Tensors], alone: Sequence[Outputs]) -> None:
    """A sequence without a start is refused."""
    _expect_refused("START", lambda: server.send(frames[0], f"check-{uuid.uuid4().hex[:12]}"))


def check_end(server: Server, frames: Sequence[Tensors], alone: Sequence[Outputs]) -> None:
    """After its end, a sequence is refused until it starts again, and then it starts cold."""
    vehicle = Vehicle(server, frames)
    vehicle.drive()
    _expect_refused("START", lambda: server.send(frames[-1], vehicle.sequence))
    restarted = server.send(frames[0], vehicle.sequence, start=True, end=True)
    _expect_equal("the restarted sequence", [restarted], alone[:1])


def check_restart(server: Server, frames: Sequence[Tensors], alone: Sequence[Outputs]) -> None:
    """A start in the middle of a sequence begins cold."""
    vehicle = Vehicle(server, frames)
    vehicle.step()
    restarted = [server.send(frames[0], vehicle.sequence, start=True), *vehicle.drive()]
    _expect_equal("the restarted sequence", restarted, alone)


def check_bad_frames(server: Server, frames: Sequence[Tensors], alone: Sequence[Outputs]) -> None:
    """Bad frames are refused, and the next good frame gives the bits that it would have given without them."""
    vehicle = Vehicle(server, frames)
    outputs = [vehicle.step()]
    damaged = frames[1] | {"images": np.array([data[: len(data) // 2] for data in frames[1]["images"]], dtype=object)}
    _expect_refused("undamaged", lambda: server.send(damaged, vehicle.sequence))
    _expect_refused("timestamp_s: expected later", lambda: server.send(frames[0], vehicle.sequence))
    unknown = frames[1] | {"global_T_ego": np.full((4, 4), np.nan)}
    _expect_refused("global_T_ego", lambda: server.send(unknown, vehicle.sequence))
    _expect_equal("after bad frames", [*outputs, *vehicle.drive()], alone)


def check_places(server: Server, frames: Sequence[Tensors], alone: Sequence[Outputs]) -> None:
    """When all places are taken, another vehicle waits or is refused after its time-out. An end frees a place."""
    vehicles = [Vehicle(server, frames) for _ in range(server.num_places)]
    for index in range(len(frames)):  # in turn, so that none is idle for long
        if index == 1:
            _expect_refused("timeout", lambda: Vehicle(server, frames).step(wait_us=IMPATIENT_US))
        for vehicle in vehicles:
            vehicle.step()
    _expect_equal("after an end", Vehicle(server, frames).drive(), alone)


def check_lost(server: Server, frames: Sequence[Tensors], alone: Sequence[Outputs]) -> None:
    """A sequence without requests for the idle time is lost. It is refused until it starts again, then cold."""
    vehicle = Vehicle(server, frames)
    vehicle.step()
    time.sleep(server.idle_s + 1)
    _expect_refused("START", vehicle.step)
    restarted = server.send(frames[1], vehicle.sequence, start=True, end=True)
    if not restarted["skipped"][0] and restarted["history_frames"][0] != 1:
        raise CheckFailed(f"expected a cold start, with 1 frame; got {restarted['history_frames'][0]}")


def check_golden(server: Server, alone: Sequence[Outputs], golden: Path) -> None:
    """The boxes are those of the bundle's golden example, which come from PyTorch."""
    tolerance = json.loads((golden / "expected.json").read_text())["tolerance"]
    lines = (golden / "results.jsonl").read_text().splitlines()
    for index, (line, outputs) in enumerate(zip(lines, alone, strict=True)):
        found = [
            (server.classes[label], score, row)
            for label, score, row in zip(outputs["class_ids"], outputs["scores"], outputs["boxes"], strict=True)
        ]
        for box in json.loads(line)["boxes"]:
            match = next((other for other in found if _is_same_box(other, box, tolerance)), None)
            if match is None:
                raise CheckFailed(f"frame {index}: expected a {box['class']} at {box['center_m']}; got none there")
            found = [other for other in found if other is not match]


def _is_same_box(found: tuple[str, float, np.ndarray], box: dict[str, Any], tolerance: dict[str, float]) -> bool:
    name, score, row = found
    expected = [*box["center_m"], *box["size_wlh_m"], box["yaw_rad"], *box["velocity_m_s"]]
    difference = row.astype(np.float64) - expected
    difference[6] = math.remainder(difference[6], 2 * math.pi)
    is_near = abs(score - box["score"]) <= tolerance["score"] and bool((abs(difference) <= tolerance["box"]).all())
    return name == box["class"] and is_near


Check = Callable[[Server, Sequence[Tensors], Sequence[Outputs]], None]
CHECKS: tuple[Check, ...] = (
    check_start,
    check_end,
    check_restart,
    check_bad_frames,
)
CHECKS_WITH_TWO_PLACES = (check_interleaved,)
CHECKS_OF_A_FREE_SERVER = (check_places, check_lost)


def main() -> int:
    """Run the checks, and return the exit code."""
    parser = argparse.ArgumentParser(description="Check that a server keeps the sequences of vehicles apart.")
    parser.add_argument("--url", default="localhost:8001", help="address of the server's gRPC service")
    parser.add_argument("--model", default="duospacenet", help="name of the model")
    parser.add_argument("--scene", type=Path, help="scene folder with the frames; default: the golden scene")
    parser.add_argument("--save", type=Path, help="write the outputs of one vehicle alone to this .npz file")
    parser.add_argument("--free", action="store_true", help="also take all places, and wait for the idle time")
    arguments = parser.parse_args()
    scene = arguments.scene or next(Path(__file__).parent.glob(GOLDEN_SCENE), None)
    if scene is None:
        parser.error("the bundle has no golden scene; choose a scene folder with --scene")
    server, frames = Server(arguments.url, arguments.model), list(read_scene(scene))
    alone = Vehicle(server, frames).drive()
    if arguments.save:
        _save(arguments.save, alone)
    checks = [*CHECKS, *(CHECKS_WITH_TWO_PLACES if server.num_places > 1 else ())]
    checks += CHECKS_OF_A_FREE_SERVER if arguments.free else ()
    results = [_passes(check, server, frames, alone) for check in checks]
    if _has_boxes(scene.parent):
        results.append(_passes(check_golden, server, alone, scene.parent))
    return 0 if all(results) else 1


def _has_boxes(golden: Path) -> bool:
    """Whether a folder is a golden example with boxes that can be compared. Those of int8 bundles cannot."""
    path = golden / "expected.json"
    return path.exists() and json.loads(path.read_text())["tolerance"]["box"] is not None


def _passes(check: Callable[..., None], *arguments: object) -> bool:
    """Run a check, print its result, and return whether it has passed."""
    try:
        check(*arguments)
    except (CheckFailed, InferenceServerException) as error:
        sys.stdout.write(f"FAILED  {check.__doc__}\n        {error}\n")
        return False
    sys.stdout.write(f"passed  {check.__doc__}\n")
    return True


def _save(path: Path, frames: Sequence[Outputs]) -> None:
    """Write the outputs by "INDEX.NAME". Texts become fixed-size bytes, which numpy stores without pickle."""
    arrays: dict[str, Any] = {f"{index}.{name}": array for index, f in enumerate(frames) for name, array in f.items()}
    np.savez(path, **{name: array.astype("S") if array.dtype == object else array for name, array in arrays.items()})


def _expect_equal(what: str, found: Sequence[Outputs], expected: Sequence[Outputs]) -> None:
    for index, (one, other) in enumerate(zip(found, expected, strict=True)):
        for name, array in other.items():
            if one[name].shape != array.shape or one[name].tolist() != array.tolist():
                raise CheckFailed(f"{what}: frame {index}: expected the {name} of one vehicle alone; got others")


def _expect_refused(text: str, send: Callable[[], object]) -> None:
    try:
        send()
    except InferenceServerException as error:
        if text not in str(error):
            raise CheckFailed(f"expected an error with {text!r}; got {error}") from None
    else:
        raise CheckFailed(f"expected an error with {text!r}; got outputs")


if __name__ == "__main__":
    sys.exit(main())
