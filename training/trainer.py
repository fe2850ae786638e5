"""The training loop: drives side by side, a frame of each a step."""

from collections.abc import Iterator
from itertools import zip_longest
from typing import Literal, NamedTuple

import torch
from torch import Tensor, nn

from ..model import DuoSpaceNet, DuoSpaceNetConfig
from ..model.decoder import FrameMemory
from ..model.duospacenet import FrameFeatures
from ..model.window import Window
from ..runtime.errors import CheckError
from .bev_supervision import BirdsEyeHead
from .clips import Drive
from .denoising import denoising_losses, noised_queries, shuffled
from .grid_mask import GridMask
from .losses import Losses, detection_losses, map_losses
from .optimisation import make_optimiser, set_rates
from .past_frames import PastFeatures, recall
from .pv_supervision import PerspectiveHead
from .settings import Settings
from .training_frames import Sample

STATISTICS_MOMENTUM = 0.01  # of BatchNorm: a step sees few frames, and what runs on later are these averages


class Step(NamedTuple):
    """What happened in a step, counted from 0: its losses by name, means over the frames, and `total`."""

    number: int
    losses: dict[str, float]
    gradient_norm: float


class Trainer:
    """A model that is being trained. All of its state is in `state_dict` between two groups of drives."""

    def __init__(self, model: DuoSpaceNet, settings: Settings, device: torch.device) -> None:
        self.model = model.to(device).train()
        self.settings = settings
        self.device = device
        self.step = 0
        self.heads = _make_heads(model.config, settings).to(device)
        self.optimiser = make_optimiser(model, self.heads, settings)
        self._mask = GridMask(settings.grid_mask)
        _set_momentum(model)

    def train_on(self, drives: list[Drive]) -> Iterator[Step]:
        """Train on a group of drives, a step a frame; whatever the last step is, the training ends there."""
        histories: list[list[PastFeatures]] = [[] for _ in drives]
        for frames in zip_longest(*drives):
            if self.step == self.settings.steps:
                return
            present = [drive for drive, sample in enumerate(frames) if sample is not None]
            moments = self.encode([frames[drive].to(self.device) for drive in present])
            for drive, moment in zip(present, moments, strict=True):
                histories[drive] = [moment, *histories[drive]][: self.model.config.num_frames]
            yield self._learn([histories[drive] for drive in present])
            for drive in present:
                histories[drive][0] = histories[drive][0].detached()

    def encode(self, samples: list[Sample]) -> list[PastFeatures]:
        """The features of frames; the backbone sees all of their images at once."""
        images = torch.cat([self._masked(sample.images) for sample in samples])
        with self._autocast():
            levels = self.model.image_encoder(images)
        by_frame = zip(*(level.float().split(self.model.config.num_cameras) for level in levels), strict=True)
        return [
            PastFeatures(sample, self._lift(list(pv), sample)) for pv, sample in zip(by_frame, samples, strict=True)
        ]

    def _lift(self, pv: list[Tensor], sample: Sample) -> FrameFeatures:
        if self.settings.pretraining or not self.model.config.has_bev:
            return FrameFeatures(pv, None)
        voxels = self.model.lifter(pv, self.model.projector(sample.image_T_ego, sample.camera_valid))
        with self._autocast():
            bev = self.model.divergence_enhancement(voxels)
        return FrameFeatures(pv, bev.float())

    def _learn(self, histories: list[list[PastFeatures]]) -> Step:
        """One step of the optimiser on the newest frames of these histories.

        Raises CheckError, before any parameter has changed, where the loss or its gradient is not finite.
        """
        generator = self._generator("noise")
        losses = _mean([self._losses(history, generator) for history in histories])
        total = torch.stack(list(losses.values())).sum()
        self._check_finite("loss", total)
        set_rates(self.optimiser, self.step, self.settings)
        self.optimiser.zero_grad(set_to_none=True)
        total.backward()
        parameters = [parameter for group in self.optimiser.param_groups for parameter in group["params"]]
        norm = nn.utils.clip_grad_norm_(parameters, self.settings.clip_norm)
        self._check_finite("gradient", norm)
        self.optimiser.step()
        self.step += 1
        figures = {name: float(loss.detach()) for name, loss in losses.items()} | {"total": float(total.detach())}
        return Step(self.step - 1, figures, float(norm))

    def _check_finite(self, what: str, value: Tensor) -> None:
        if not bool(value.isfinite()):
            raise CheckError(
                f"step {self.step}: expected a finite {what}; got {float(value.detach())}. Begin anew in another --out "
                "with a smaller learning rate or another seed."
            )

    def _losses(self, history: list[PastFeatures], generator: torch.Generator) -> Losses:
        sample, features = history[0]
        if self.settings.pretraining:
            return self._supervise(features, sample)
        memory, window = recall(self.model, history)
        predictions = self.model.detect(memory, window)
        losses = detection_losses(predictions, sample.boxes, sample.labels, self.settings.auxiliary_matches)
        if self.settings.denoising:
            losses |= self._denoise(sample.boxes, memory, window, generator)
        with self._autocast():
            maps = self.model.draw_map(features)
        losses |= map_losses({name: logits.float() for name, logits in maps.items()}, sample.maps)
        return losses | self._supervise(features, sample)

    def _supervise(self, features: FrameFeatures, sample: Sample) -> Losses:
        """What the heads beside the model say of the features."""
        losses: Losses = {}
        for head in self.heads:
            assert isinstance(head, PerspectiveHead | BirdsEyeHead)
            with self._autocast():
                maps = head(features)
            losses |= head.losses(maps.float(), sample)
        return losses

    def _denoise(self, boxes: Tensor, memory: list[FrameMemory], window: Window, generator: torch.Generator) -> Losses:
        """Means over the sets; nothing to begin beside is nothing to lose."""
        config = self.model.config
        if not len(boxes):
            return {f"denoised_{layer}": boxes.new_zeros(()) for layer in range(config.num_layers)}
        sets = []
        for _ in range(self.settings.denoising):
            noised = shuffled(boxes, generator, config.queries == "unshared")
            content, pose = noised_queries(self.model.queries.content, noised, generator)
            sets.append(denoising_losses(self.model.decoder(content, pose, memory, window), noised))
        return _mean(sets)

    def _masked(self, images: Tensor) -> Tensor:
        """Images (N, H, W, 3) with squares taken out; the grid hangs on the seed and the step alone."""
        if not self.settings.grid_mask:
            return images
        self._mask.set_epoch(self.step, self.settings.steps)
        image = self.model.config.image
        mean = torch.tensor(image.mean)
        return self._mask(images, self._generator("mask"), mean.flip(0) if image.colour_order == "rgb" else mean)

    def _generator(self, purpose: Literal["mask", "noise"]) -> torch.Generator:
        """What is random in a step hangs on the seed and the step alone."""
        number = self.settings.seed * self.settings.steps + self.step
        return torch.Generator().manual_seed(2 * number + (purpose == "noise"))

    def _autocast(self) -> torch.autocast:
        return torch.autocast(self.device.type, torch.bfloat16, enabled=self.settings.bf16)

    def state_dict(self) -> dict[str, object]:
        """All that the next step depends on."""
        return {
            "step": self.step,
            "model": self.model.state_dict(),
            "heads": self.heads.state_dict(),
            "optimiser": self.optimiser.state_dict(),
        }

    def load_state_dict(self, state: dict) -> None:
        """Go on from what `state_dict` gave, with the same settings."""
        self.step = state["step"]
        self.model.load_state_dict(state["model"])
        self.heads.load_state_dict(state["heads"])
        self.optimiser.load_state_dict(state["optimiser"])


def _mean(losses: list[Losses]) -> Losses:
    return {name: torch.stack([part[name] for part in losses]).mean() for name in losses[0]}


def _make_heads(config: DuoSpaceNetConfig, settings: Settings) -> nn.ModuleList:
    """The heads as torch draws them from the seed; torch's own generator stays where it was."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(settings.seed)
        heads = nn.ModuleList()
        if settings.perspective:
            heads.append(PerspectiveHead(config))
        if settings.birds_eye and config.has_bev and not settings.pretraining:
            heads.append(BirdsEyeHead(config))
        return heads


def _set_momentum(model: nn.Module) -> None:
    for module in model.modules():
        if isinstance(module, (nn.BatchNorm2d, nn.BatchNorm3d)):
            module.momentum = STATISTICS_MOMENTUM
