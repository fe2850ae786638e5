"""What Triton's Python backend gives to a model: requests, and the module `triton_python_backend_utils`.

Written from NVIDIA's documentation of the Python backend. Only the parts that `TritonModel` uses are here.
"""

import json
from collections.abc import Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np

from duospacenet.jobs.serving.serving_options import ServingOptions
from duospacenet.jobs.serving.triton_model import TritonModel
from duospacenet.runtime import Frame

OUTPUTS = ("boxes", "scores", "class_ids", "attributes", "history_frames", "reset_reason", "skipped", "dropped", "maps")


class FakeTensor:
    """`pb_utils.Tensor`."""

    def __init__(self, name: str, array: np.ndarray) -> None:
        self._name, self._array = name, array

    @classmethod
    def from_dlpack(cls, name: str, tensor: "FakeTensor") -> "FakeTensor":
        return cls(name, tensor.as_numpy().copy())

    def name(self) -> str:
        return self._name

    def as_numpy(self) -> np.ndarray:
        return self._array


class FakeError:
    """`pb_utils.TritonError`."""

    INTERNAL, INVALID_ARG = 1, 2

    def __init__(self, message: str, code: int = INTERNAL) -> None:
        self._message, self._code = message, code

    def message(self) -> str:
        return self._message

    def code(self) -> int:
        return self._code


class FakeResponse:
    """`pb_utils.InferenceResponse`: output tensors, or an error."""

    def __init__(self, output_tensors: Sequence[FakeTensor] = (), error: FakeError | None = None) -> None:
        self._tensors, self._error = list(output_tensors), error

    def output_tensors(self) -> list[FakeTensor]:
        return self._tensors

    def error(self) -> FakeError | None:
        return self._error

    def arrays(self) -> dict[str, np.ndarray]:
        """The outputs by name. Fails for a response with an error."""
        assert self._error is None, self._error.message()
        return {tensor.name(): tensor.as_numpy() for tensor in self._tensors}

    def refusal(self) -> str:
        """The message of a refused request. Fails for outputs, and for an error that is not the client's."""
        assert self._error is not None, "the request was not refused"
        assert self._error.code() == FakeError.INVALID_ARG
        assert self._tensors == []
        return self._error.message()


class FakeModelException(Exception):
    """`pb_utils.TritonModelException`."""


class FakeRequest:
    """`pb_utils.InferenceRequest` with the control inputs of the sequence batcher."""

    def __init__(
        self, inputs: dict[str, np.ndarray], sequence: int | str, start: bool, end: bool, outputs: Sequence[str]
    ) -> None:
        controls = {"START": np.array([start], np.float32), "END": np.array([end], np.float32)}
        self._inputs = [FakeTensor(name, array) for name, array in (inputs | controls).items()]
        self._sequence, self._outputs = sequence, outputs

    def inputs(self) -> list[FakeTensor]:
        return self._inputs

    def correlation_id(self) -> int | str:
        return self._sequence

    def requested_output_names(self) -> set[str]:
        return set(self._outputs)


def fake_utils(tensor: type[FakeTensor] = FakeTensor) -> Any:
    """The module `triton_python_backend_utils`. tensor: another class of tensors."""
    return SimpleNamespace(
        Tensor=tensor, TritonError=FakeError, InferenceResponse=FakeResponse, TritonModelException=FakeModelException
    )


def model_config(options: ServingOptions) -> dict[str, Any]:
    """The model configuration as Triton passes it on: numbers of 64 bits as they are, parameters as texts."""
    settings = {"threads": "", "on_missing": options.on_missing, "history_step_s": ""}
    return {
        "parameters": {name: {"string_value": value} for name, value in settings.items()},
        "sequence_batching": {
            "max_sequence_idle_microseconds": round(1e6 * options.idle_s),
            "oldest": {"max_candidate_sequences": options.sequences_per_instance},
        },
        "instance_group": [{"kind": "KIND_CPU", "count": options.instances}],
        "name": options.name,
    }


class FakeServer:
    """A model that was loaded from a repository, and a client that sends frames to it."""

    def __init__(self, bundle: Path, folder: Path, options: ServingOptions | None = None, **changes: Any) -> None:
        """folder: a new folder, which gets the version of the model. changes: of the model configuration."""
        (folder / "1").mkdir(parents=True)
        (folder / "1/bundle").symlink_to(bundle)
        config = model_config(options or ServingOptions()) | changes
        arguments = {"model_config": json.dumps(config), "model_repository": str(folder), "model_version": "1"}
        self.model = TritonModel(fake_utils(), arguments)

    def send(
        self,
        frame: Frame | dict[str, np.ndarray],
        sequence: int | str,
        start: bool = False,
        end: bool = False,
        outputs: Sequence[str] = OUTPUTS,
    ) -> FakeResponse:
        """Send one frame, and return the response."""
        inputs = request_inputs(frame) if isinstance(frame, Frame) else frame
        (response,) = self.model.execute([FakeRequest(inputs, sequence, start, end, outputs)])
        return response

    def drive(self, frames: Sequence[Frame], sequence: int | str) -> list[dict[str, np.ndarray]]:
        """Send frames as one whole sequence, and return the outputs of each."""
        last = len(frames) - 1
        return [self.send(f, sequence, i == 0, i == last).arrays() for i, f in enumerate(frames)]


def request_inputs(frame: Frame) -> dict[str, np.ndarray]:
    """The inputs of a request for a frame, with its images as PNG files."""
    cameras = list(frame.cameras.values())
    return {
        "timestamp_s": np.array([frame.timestamp_s], np.float64),
        "global_T_ego": np.asarray(frame.global_T_ego, np.float64),
        "camera_names": np.array([name.encode() for name in frame.cameras], dtype=object),
        "images": np.array([_png(frame.images[name]) for name in frame.cameras], dtype=object),
        "size_px": np.array([[camera.width_px, camera.height_px] for camera in cameras], np.int32),
        "intrinsics_px": np.array([camera.intrinsics_px for camera in cameras], np.float64),
        "camera_T_ego": np.array([camera.camera_T_ego for camera in cameras], np.float64),
        "scene": np.array([frame.scene.encode()], dtype=object),
    }


def _png(image: np.ndarray | None) -> bytes:
    return b"" if image is None else cv2.imencode(".png", image)[1].tobytes()
