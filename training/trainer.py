"""The trainer: optimiser steps on batches of clips, in one process or in several."""

import math
from collections.abc import Iterable, Iterator, Sequence
from contextlib import AbstractContextManager, nullcontext
from itertools import chain, repeat
from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn.parallel import DistributedDataParallel

from ..model import DuoSpaceNet
from ..runtime.errors import CheckError, UsageError
from .batch_norm import average_batch_norm_statistics, set_batch_norm_momentum
from .distributed import Processes
from .encoded_frames import EncodedFrame
from .freezing import freeze
from .losses.frame_losses import frame_weight
from .objective import Objective
from .optimisation import make_optimiser, set_learning_rates
from .sampled_clip import Sample, SampledClip
from .samples.training_frames import Clip, TrainingFrame
from .settings import Settings
from .tasks import num_past_frames
from .weight_average import WeightAverage

MIN_LOSS_SCALE = 1.0  # float16: gradients that overflow at this scale do so because they are not finite


class TrainingStep(NamedTuple):
    """The result of one optimiser step.

    number: the number of the step, counted from 0.
    losses: the losses by name, each averaged over the frames of the step in all processes, and their sum as `total`.
    gradient_norm: the norm of the gradient before clipping. None if the gradient exceeded the range of float16: the
        weights are then unchanged.
    num_frames: the frames of the step, in all processes.
    """

    number: int
    losses: dict[str, float]
    gradient_norm: float | None
    num_frames: int


class Trainer:
    """A model in training, with its supervision heads and its optimiser.

    Between two batches, `state_dict` holds the full state. Within a batch it lacks the histories of the clips. All
    random numbers depend on the seed, the step and the number of the clip in the batch only.

    In several processes, each trains on its part of the batch. The gradient, the losses and the BatchNorm statistics
    are averaged, so that the weights are the same in all processes.

    model: the model, which is moved to the device of this process and changed in place.
    processes: the processes of the training, from `join_processes`.
    accumulation_steps: the number of parts in which each process computes its frames of a step. More parts need less
        memory. They change the gradient by rounding only, unless the BatchNorm of the image encoder is trained.
    """

    def __init__(
        self,
        model: DuoSpaceNet,
        settings: Settings,
        processes: Processes | torch.device,
        accumulation_steps: int = 1,
    ) -> None:
        self.processes = processes if isinstance(processes, Processes) else Processes(device=processes)
        self.device = self.processes.device
        self.model = model.to(self.device).train()
        self.settings = settings
        self.accumulation_steps = accumulation_steps
        self.step = 0
        set_batch_norm_momentum(model)
        freeze(model, settings)
        self.objective = Objective(model, settings).to(self.device)
        self.heads = self.objective.heads
        self.optimiser = make_optimiser(model, self.heads, settings)
        self._average = WeightAverage(model, settings.ema_decay) if settings.ema_decay else None
        self._scaler = torch.amp.GradScaler(self.device.type, enabled=settings.amp == "float16")
        # Each process updates its own BatchNorm statistics. The trainer averages them, so DDP does not broadcast them.
        self._wrapped: nn.Module = (
            DistributedDataParallel(self.objective, broadcast_buffers=False, gradient_as_bucket_view=True)
            if self.processes.count > 1
            else self.objective
        )

    @property
    def evaluated_model(self) -> DuoSpaceNet:
        """The model to evaluate and to save: with the averaged weights if `ema_decay` is set."""
        return self.model if self._average is None else self._average.model

    @property
    def local_batch_size(self) -> int:
        """The clips per batch in this process."""
        return self.settings.batch_size // self.processes.count

    def train_on(self, batch: Sequence[Clip], num_steps: Sequence[int] | None = None) -> Iterator[TrainingStep]:
        """Train on a batch of clips; each step uses the next sample of every clip that still has one.

        batch: the clips of this process.
        num_steps: the number of samples of every clip, in all processes. By default, those of `batch`.

        Stops after the last step of the training run, even within a batch. Raises CheckError if a loss or a gradient is
        not finite, and UsageError if the GPU has too little memory for the batch.
        """
        first = self.processes.rank * self.local_batch_size
        num_past = num_past_frames(self.settings, self.model.config)
        clips = [SampledClip(clip, first + n, self.settings, num_past) for n, clip in enumerate(batch)]
        lengths = [clip.num_samples for clip in clips] if num_steps is None else num_steps
        for index in range(max(lengths)):
            if self.step == self.settings.steps:
                return
            num_frames = sum(length > index for length in lengths)
            parts = [[clip for clip in part if index < clip.num_samples] for part in self._parts(clips)]
            present = list(chain.from_iterable(parts))
            weights = self._detection_weights([clip.newest(index) for clip in present], num_frames)
            # A generator, because only one part at a time needs to be on the device.
            samples = ([clip.sample(index, next(weights), self.device) for clip in part] for part in parts)
            try:
                step, encoded = self._optimise(samples, num_frames)
            except torch.OutOfMemoryError as error:
                raise self._memory_error(error) from error
            for clip, newest in zip(present, encoded, strict=True):
                clip.remember(newest)
            yield step

    def _parts(self, clips: list[SampledClip]) -> list[list[SampledClip]]:
        """Divide the clips of this process into `accumulation_steps` parts."""
        size = math.ceil(len(clips) / self.accumulation_steps)
        return [clips[number * size : (number + 1) * size] for number in range(self.accumulation_steps)]

    def _detection_weights(self, frames: list[TrainingFrame], num_frames: int) -> Iterator[float]:
        """The weight of the detection losses of each frame, see `frame_weight`. All are 1 with `loss_average` "frame".

        frames: the frames of this process. num_frames: the number of frames in all processes.
        """
        if self.settings.loss_average == "frame":
            return repeat(1.0)
        # A query has one object at most.
        num_objects = [min(len(frame.boxes), self.model.config.num_queries) for frame in frames]
        total = self.processes.sum(torch.tensor([sum(num_objects)], dtype=torch.float64, device=self.device))
        mean = float(total) / num_frames
        return iter([frame_weight(number, mean) for number in num_objects])

    def _optimise(self, parts: Iterable[list[Sample]], num_frames: int) -> tuple[TrainingStep, list[EncodedFrame]]:
        """Take one optimiser step on the samples of all parts. Returns it, and the features of the samples, detached.

        num_frames: the frames of this step in all processes.

        Raises CheckError if the loss or the gradient is not finite. The parameters are then unchanged.
        """
        set_learning_rates(self.optimiser, self.step, self.settings)
        self.optimiser.zero_grad(set_to_none=True)
        losses = torch.zeros(len(self.objective.loss_names), device=self.device)
        encoded: list[EncodedFrame] = []
        for number, samples in enumerate(parts, start=1):
            if not samples and (number < self.accumulation_steps or self.processes.count == 1):
                continue  # the last part of a process takes part in the exchange of gradients, also without samples
            with self._gradient_exchange(number == self.accumulation_steps):
                sums, features = self._wrapped(samples, self.step)
                # DDP averages the gradients of the processes. The loss is an average over the frames of all of them.
                self._scaler.scale(sums.sum() * (self.processes.count / num_frames)).backward()
            losses += sums.detach()
            encoded += [EncodedFrame(sample.frame, one) for sample, one in zip(samples, features, strict=True)]
        return self._update(self.processes.sum(losses) / num_frames, num_frames), encoded

    def _gradient_exchange(self, is_last: bool) -> AbstractContextManager:
        """Only the backward pass of the last part exchanges gradients with the other processes."""
        wrapped = self._wrapped
        return wrapped.no_sync() if isinstance(wrapped, DistributedDataParallel) and not is_last else nullcontext()

    def _update(self, losses: Tensor, num_frames: int) -> TrainingStep:
        """Update the weights with the gradients, and count the step."""
        self._scaler.unscale_(self.optimiser)
        parameters = [parameter for group in self.optimiser.param_groups for parameter in group["params"]]
        norm = nn.utils.clip_grad_norm_(parameters, self.settings.clip_norm)
        # One transfer for all values, because each one waits for the GPU.
        *values, total, gradient_norm = torch.cat([losses, torch.stack([losses.sum(), norm])]).tolist()
        self._check_finite("loss", total)
        if not self._scaler.is_enabled() or self._scaler.get_scale() <= MIN_LOSS_SCALE:
            self._check_finite("gradient", gradient_norm)
        self._scaler.step(self.optimiser)
        self._scaler.update()
        average_batch_norm_statistics(self.model, self.processes)
        if self._average is not None:
            self._average.update(self.model, self.step)
        self.step += 1
        named = dict(zip(self.objective.loss_names, values, strict=True)) | {"total": total}
        return TrainingStep(self.step - 1, named, gradient_norm if math.isfinite(gradient_norm) else None, num_frames)

    def _check_finite(self, quantity: str, value: float) -> None:
        if not math.isfinite(value):
            raise CheckError(
                f"step {self.step + 1}: expected a finite {quantity}; got {value}. Start a new training run in another "
                "--out with a smaller learning rate or another seed."
            )

    def _memory_error(self, error: torch.OutOfMemoryError) -> UsageError:
        return UsageError(
            f"step {self.step + 1}: expected a batch that fits into the memory of {self.device}; got "
            f"{str(error).split('. ')[0]}. Use more --accumulation-steps, --activation-checkpointing, or a smaller "
            "--batch-size."
        )

    def state_dict(self) -> dict[str, object]:
        """Everything that the next step depends on. It is the same in all processes, but for BatchNorm's counters."""
        state: dict[str, object] = {
            "step": self.step,
            "model": self.model.state_dict(),
            "heads": self.heads.state_dict(),
            "optimiser": self.optimiser.state_dict(),
        }
        if self._average is not None:
            state["average"] = self._average.state_dict()
        if self._scaler.is_enabled():
            state["loss_scale"] = self._scaler.state_dict()
        return state

    def load_state_dict(self, state: dict) -> None:
        """Restore the state that `state_dict` returned, of a trainer with the same settings."""
        self.step = state["step"]
        self.model.load_state_dict(state["model"])
        self.heads.load_state_dict(state["heads"])
        self.optimiser.load_state_dict(state["optimiser"])
        if self._average is not None:
            self._average.load_state_dict(state["average"])
        if self._scaler.is_enabled():
            self._scaler.load_state_dict(state["loss_scale"])
