"""Runners of stateless alternatives, which compute a whole window for every frame: PyTorch, onnxruntime, OpenVINO."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from ...runtime import Frame
from ...runtime.bundle.manifest import GraphSpec, Manifest, slot_name
from ...runtime.detections import select_detections, sigmoid
from ...runtime.extras import needs_extra
from ...runtime.history import History, PastFrame
from ...runtime.onnxruntime_session import OnnxruntimeSession, set_thread_pool_size
from ...runtime.pipeline import StageTimer
from ...runtime.preprocessing import prepare
from ...runtime.session import Session, to_tensors

if TYPE_CHECKING:
    from ...model import DuoSpaceNet

IMAGES = "images"

Arrays = dict[str, NDArray]


class StatelessNetwork(Protocol):
    """A network that takes the images of a whole window, with the inputs and outputs of `export.stateless`."""

    def __call__(self, inputs: Arrays) -> Arrays: ...


class StatelessRunner:
    """Runs a stateless network on a stream of frames, with the host code of the runtime around it.

    Only the newest frame is preprocessed. The images of the window's other frames are kept.
    """

    def __init__(self, manifest: Manifest, network: StatelessNetwork) -> None:
        """manifest: of the bundle with the same model: its window, preprocessing and number of cameras."""
        self.window = manifest.window.num_frames
        self._manifest = manifest.model_copy(update={"memory": (IMAGES,)})
        size_px = manifest.preprocessing.height_px, manifest.preprocessing.width_px
        self._no_images = to_tensors(**{IMAGES: np.zeros((manifest.num_cameras, *size_px, 3), np.uint8)})
        self._network = network
        self._history = History(self._manifest)

    def step(self, frame: Frame) -> Mapping[str, float]:
        clock = StageTimer()
        with clock("preprocess"):
            inputs, now = self._inputs(frame)
        with clock("model"):
            outputs = self._network(inputs)
        with clock("postprocess"):
            select_detections(outputs.pop("class_logits"), outputs.pop("boxes"))
            for mask in outputs.values():
                sigmoid(mask[0, 0])
        self._history = self._history.after(now)
        return clock.seconds

    def reset(self) -> None:
        self._history = History(self._manifest)

    def _inputs(self, frame: Frame) -> tuple[Arrays, PastFrame]:
        """The network's inputs for the window that ends with `frame`, and the record of this frame."""
        prepared = prepare(frame, self._manifest.preprocessing, self._manifest.num_cameras)
        now = PastFrame.of(frame, prepared, to_tensors(**{IMAGES: prepared.images}))
        tensors, _ = self._history.decoder_inputs(now, self._no_images)
        slots = [tensors.pop(slot_name(slot, IMAGES)).numpy() for slot in range(self.window)]
        # Copies, because an array from `OrtValue.numpy` does not keep the memory of the OrtValue alive.
        return {IMAGES: np.stack(slots), **{name: value.numpy().copy() for name, value in tensors.items()}}, now


class TorchNetwork:
    """The model in PyTorch: eager, or compiled by `torch.compile`."""

    def __init__(self, model: "DuoSpaceNet", threads: int, compiled: bool) -> None:
        with needs_extra("export"):
            import torch

            from ...export.stateless import INPUTS, StatelessModel
        torch.set_num_threads(threads)
        self._torch, self._inputs = torch, INPUTS
        self._names = ["class_logits", "boxes", *model.config.map_classes]
        module = StatelessModel(model.eval())
        if compiled:
            _check_compiler(torch)
        self._module = torch.compile(module) if compiled else module

    def __call__(self, inputs: Arrays) -> Arrays:
        with self._torch.inference_mode():
            outputs = self._module(*(self._torch.from_numpy(inputs[name]) for name in self._inputs))
        return {name: output.numpy() for name, output in zip(self._names, outputs, strict=True)}


def _check_compiler(torch: Any) -> None:
    """Compile one operator, which fails within seconds if there is no compiler. Raises RuntimeError with the reason."""
    try:
        torch.compile(torch.neg)(torch.ones(1))
    except Exception as error:  # torch has many exception types for this, and most are private
        # The messages end with advice about environment variables. The reason is at the start.
        reason = str(error).strip().partition("\n")[0]
        raise RuntimeError(f"torch.compile needs a working C++ compiler: {type(error).__name__}: {reason}") from None


class GraphNetwork:
    """The stateless ONNX graph in onnxruntime, or in OpenVINO at its default precision."""

    def __init__(self, path: Path, spec: GraphSpec, threads: int, engine: str) -> None:
        self._session = _open_session(path, spec, threads, engine)

    def __call__(self, inputs: Arrays) -> Arrays:
        outputs = self._session.run(to_tensors(**inputs))
        return {name: value.numpy().copy() for name, value in outputs.items()}  # see StatelessRunner._inputs


def _open_session(path: Path, spec: GraphSpec, threads: int, engine: str) -> Session:
    if engine == "openvino":
        from ...runtime.openvino_session import OpenvinoSession

        return OpenvinoSession(path.read_bytes(), spec, path, threads, precision=None)
    set_thread_pool_size(threads)
    return OnnxruntimeSession(path.read_bytes(), spec, path)
