"""An estimate of the memory that a training needs on each GPU, without computing or allocating anything."""

import weakref
from collections.abc import Iterable
from dataclasses import replace
from typing import Any, NamedTuple

import torch
from torch import Tensor
from torch._subclasses.fake_tensor import FakeTensorMode
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves

from ..model import DuoSpaceNet, DuoSpaceNetConfig
from .activation_checkpointing import checkpoint_activations
from .encoded_frames import EncodedFrame, decoder_inputs
from .freezing import freeze
from .losses.frame_losses import map_losses
from .objective import Objective
from .samples.training_frames import TrainingFrame
from .settings import Settings
from .tasks import num_past_frames

GB = 1e9
ADAMW_MOMENTS = 2  # numbers that AdamW stores per parameter
NUM_OBJECTS = 100  # in a frame with much traffic, for the denoising queries


class MemoryEstimate(NamedTuple):
    """The memory of one process [bytes].

    weights: parameters and buffers of the model and its supervision heads.
    gradients, optimiser: of the trained parameters.
    average: the moving average of the weights.
    past_frames: the features of the past frames.
    activations: the tensors that a forward and a backward pass hold at the same time, at their peak.
    """

    weights: float
    gradients: float
    optimiser: float
    average: float
    past_frames: float
    activations: float

    @property
    def total(self) -> float:
        """The sum."""
        return sum(self)

    def __str__(self) -> str:
        names = {"optimiser": "AdamW", "average": "moving average", "past_frames": "past frames"}
        parts = [f"{names.get(name, name)} {size / GB:.1f}" for name, size in self._asdict().items() if size]
        return f"about {self.total / GB:.1f} GB ({', '.join(parts)})"


def estimate_memory(
    config: DuoSpaceNetConfig,
    settings: Settings,
    frames: int = 1,
    checkpointing: bool = False,
    accumulation_steps: int = 1,
) -> MemoryEstimate:
    """Estimate the memory of a training.

    frames: frames that a process computes at once: the batch size divided by the number of processes and of
        accumulation steps.
    checkpointing: whether activations are checkpointed.
    accumulation_steps: the parts of a step. With "stream", a process keeps the past frames of all parts.

    The forward and backward passes of one frame run on fake tensors, which have shapes but no numbers. The largest
    total size of all tensors that are alive at the same time is the size of the activations. It is multiplied by the
    number of frames. Workspaces of the libraries are not included.
    """
    # Fake images cannot be masked, and masks take no memory beyond a step's images.
    settings = replace(settings, grid_mask=0.0)
    # On fake CPU tensors also for a GPU: the autograd engine needs a real GPU for fake CUDA tensors.
    with FakeTensorMode():
        objective = _fake_objective(config, settings, checkpointing)
        frame = _fake_frame(config)
        with torch.no_grad():
            past = [objective.encode([frame], 0, [0])[0] for _ in range(num_past_frames(settings, config))]
        inputs = [*objective.parameters(), *objective.buffers(), *frame, *_features(past)]
        with _LiveTensors(inputs) as live:
            total, _kept = _pass_forward(objective, frame, past)
            total.backward()
    num_histories = frames * (accumulation_steps if settings.history == "stream" else 1)
    trained = sum(_num_bytes(parameter) for parameter in objective.parameters() if parameter.requires_grad)
    model = sum(map(_num_bytes, [*objective.model.parameters(), *objective.model.buffers()]))
    return MemoryEstimate(
        weights=model + sum(map(_num_bytes, objective.heads.parameters())),
        gradients=trained,
        optimiser=ADAMW_MOMENTS * trained,
        average=model if settings.ema_decay else 0,
        past_frames=num_histories * sum(map(_num_bytes, _features(past))),
        activations=frames * live.peak,
    )


def _fake_objective(config: DuoSpaceNetConfig, settings: Settings, checkpointing: bool) -> Objective:
    model = DuoSpaceNet(config).train()
    freeze(model, settings)
    if checkpointing:
        checkpoint_activations(model)
    return Objective(model, settings)


def _fake_frame(config: DuoSpaceNetConfig) -> TrainingFrame:
    cameras, image, num_maps = config.num_cameras, config.image, len(config.map_classes)
    return TrainingFrame(
        images=torch.zeros(cameras, image.height_px, image.width_px, 3, dtype=torch.uint8),
        image_T_ego=torch.zeros(cameras, 3, 4),
        camera_valid=torch.ones(cameras, dtype=torch.bool),
        global_T_ego=torch.eye(4, dtype=torch.float64),
        timestamp_s=torch.zeros((), dtype=torch.float64),
        boxes=torch.zeros(NUM_OBJECTS, 9),
        labels=torch.zeros(NUM_OBJECTS, dtype=torch.int64),
        maps=torch.zeros(num_maps, *config.voxels.size[:2], dtype=torch.bool),
        map_known=torch.ones(num_maps, dtype=torch.bool),
        boxes_known=torch.ones((), dtype=torch.bool),
    )


def _pass_forward(objective: Objective, frame: TrainingFrame, past: list[EncodedFrame]) -> tuple[Tensor, Any]:
    """The forward pass of `Objective`, without the losses of boxes, which need numbers and little memory.

    Returns a sum of all outputs, and the features of the frame, which the trainer keeps as well.
    """
    (newest,) = objective.encode([frame], 0, [0])
    outputs: list[Any] = [head(newest.features) for head in objective.heads]
    if objective.tasks.detection and not objective.settings.pretraining:
        outputs += _detect(objective, [newest, *past])
    if objective.tasks.maps:
        maps = {name: logits.float() for name, logits in objective.model.segment_map(newest.features).items()}
        outputs.append(map_losses(maps, frame.maps, frame.map_known, objective.settings))
    return torch.stack([output.float().sum() for output in tree_leaves(outputs)]).sum(), newest.detached()


def _detect(objective: Objective, frames: list[EncodedFrame]) -> list[Any]:
    """The predictions of the queries and of the denoising queries."""
    model = objective.model
    caches, window = decoder_inputs(model, frames)
    content, pose = (tensor[:NUM_OBJECTS] for tensor in model.queries())
    denoised = [model.decoder(content, pose, caches, window) for _ in range(objective.settings.denoising)]
    return [model.detect(caches, window), *denoised]


class _LiveTensors(TorchDispatchMode):
    """Tracks the memory of the tensors that operators return while it is active.

    now: the size [bytes] of those that are alive. peak: the largest value of `now`.

    inputs: tensors that are not counted, nor are views of them.
    """

    def __init__(self, inputs: Iterable[Tensor]) -> None:
        super().__init__()
        self.now = self.peak = 0
        self._storages = weakref.WeakSet(tensor.untyped_storage() for tensor in inputs)

    def __torch_dispatch__(self, function: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        result = function(*args, **(kwargs or {}))
        for tensor in tree_leaves(result):
            if isinstance(tensor, Tensor):
                self._track(tensor.untyped_storage())
        return result

    def _track(self, storage: torch.UntypedStorage) -> None:
        if storage in self._storages:  # of a view, or changed in place
            return
        self._storages.add(storage)
        weakref.finalize(storage, self._release, storage.nbytes())
        self.now += storage.nbytes()
        self.peak = max(self.peak, self.now)

    def _release(self, size: int) -> None:
        self.now -= size


def _features(frames: list[EncodedFrame]) -> list[Tensor]:
    """The PV and BEV features of all frames."""
    return [tensor for frame in frames for tensor in (*frame.features.pv, frame.features.bev) if tensor is not None]


def _num_bytes(tensor: Tensor) -> int:
    return tensor.numel() * tensor.element_size()
