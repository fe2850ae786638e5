"""The trainer: optimiser steps on batches of clips."""

from collections.abc import Iterator
from itertools import zip_longest
from typing import Literal, NamedTuple

import torch
from torch import Tensor, nn

from ..model import DuoSpaceNet, DuoSpaceNetConfig
from ..model.decoder import FrameCache
from ..model.duospacenet import FrameFeatures
from ..model.window import Window
from ..runtime.errors import CheckError
from .bev_supervision import BEVSupervisionHead
from .denoising import denoising_losses, denoising_queries, shuffle_boxes
from .encoded_frames import EncodedFrame, decoder_inputs
from .frozen_backbone import freeze_backbone
from .grid_mask import GridMask
from .losses import Losses, detection_losses, map_losses
from .optimisation import make_optimiser, set_learning_rates
from .pv_supervision import PVSupervisionHead
from .settings import Settings
from .training_frames import Clip, TrainingFrame

# A step has few frames, so the running statistics of BatchNorm are averaged over about a hundred steps.
BATCH_NORM_MOMENTUM = 0.01


class TrainingStep(NamedTuple):
    """The result of one optimiser step.

    number: the number of the step, counted from 0.
    losses: the losses by name, each averaged over the frames of the step, and their sum as `total`.
    gradient_norm: the norm of the gradient before clipping.
    """

    number: int
    losses: dict[str, float]
    gradient_norm: float


class Trainer:
    """A model in training, with its supervision heads and its optimiser.

    Between two batches, `state_dict` holds the full state. Within a batch it lacks the histories of the clips.
    All random numbers depend on the seed and the step only.
    """

    def __init__(self, model: DuoSpaceNet, settings: Settings, device: torch.device) -> None:
        self.model = model.to(device).train()
        freeze_backbone(model.image_encoder.backbone, settings)
        self.settings = settings
        self.device = device
        self.step = 0
        self.heads = _make_heads(model.config, settings).to(device)
        self.optimiser = make_optimiser(model, self.heads, settings)
        self._grid_mask = GridMask(settings.grid_mask)
        _set_batch_norm_momentum(model)

    def train_on(self, batch: list[Clip]) -> Iterator[TrainingStep]:
        """Train on a batch of clips; each step uses the next frame of every clip that still has one.

        Stops after the last step of the training run, even within a batch. Raises CheckError if a loss or a gradient is
        not finite.
        """
        histories: list[list[EncodedFrame]] = [[] for _ in batch]
        for frames in zip_longest(*batch):
            if self.step == self.settings.steps:
                return
            present = [clip for clip, frame in enumerate(frames) if frame is not None]
            encoded = self.encode([frames[clip].to(self.device) for clip in present])
            for clip, newest in zip(present, encoded, strict=True):
                histories[clip] = [newest, *histories[clip]][: self.model.config.num_frames]
            yield self._optimise([histories[clip] for clip in present])
            for clip in present:
                histories[clip][0] = histories[clip][0].detached()

    def encode(self, frames: list[TrainingFrame]) -> list[EncodedFrame]:
        """Compute the features of frames. The image encoder gets the images of all frames in one batch."""
        images = torch.cat([self._mask_images(frame.images) for frame in frames])
        with self._autocast():
            levels = self.model.image_encoder(images)
        # The other parts take one frame at a time, because the projection of each frame differs.
        by_frame = zip(*(level.float().split(self.model.config.num_cameras) for level in levels), strict=True)
        return [EncodedFrame(frame, self._lift(list(pv), frame)) for pv, frame in zip(by_frame, frames, strict=True)]

    def _lift(self, pv: list[Tensor], frame: TrainingFrame) -> FrameFeatures:
        if self.settings.pretraining or not self.model.config.has_bev:
            return FrameFeatures(pv, None)
        # The lifter computes in float32: rounding to bfloat16 would move sampling locations by several pixels.
        tables = self.model.projector(frame.image_T_ego, frame.camera_valid)
        voxels = self.model.lifter(self.model.lifter.reduce(pv), tables)
        with self._autocast():
            bev = self.model.divergence_enhancement(voxels)
        return FrameFeatures(pv, bev.float())

    def _optimise(self, histories: list[list[EncodedFrame]]) -> TrainingStep:
        """Take one optimiser step on the newest frame of each history.

        Raises CheckError if the loss or the gradient is not finite. The parameters are then unchanged.
        """
        generator = self._generator("noise")
        losses = _mean([self._losses(history, generator) for history in histories])
        total = torch.stack(list(losses.values())).sum()
        self._check_finite("loss", total)
        set_learning_rates(self.optimiser, self.step, self.settings)
        self.optimiser.zero_grad(set_to_none=True)
        total.backward()
        parameters = [parameter for group in self.optimiser.param_groups for parameter in group["params"]]
        norm = nn.utils.clip_grad_norm_(parameters, self.settings.clip_norm)
        self._check_finite("gradient", norm)
        self.optimiser.step()
        self.step += 1
        values = {name: float(loss.detach()) for name, loss in losses.items()} | {"total": float(total.detach())}
        return TrainingStep(self.step - 1, values, float(norm))

    def _check_finite(self, quantity: str, value: Tensor) -> None:
        if not bool(value.isfinite()):
            raise CheckError(
                f"step {self.step}: expected a finite {quantity}; got {float(value.detach())}. Start a new training "
                "run in another --out with a smaller learning rate or another seed."
            )

    def _losses(self, history: list[EncodedFrame], generator: torch.Generator) -> Losses:
        """All losses of the newest frame of a history."""
        frame, features = history[0]
        if self.settings.pretraining:
            return self._supervision_losses(features, frame)
        caches, window = decoder_inputs(self.model, history)
        predictions = self.model.detect(caches, window)
        losses = detection_losses(predictions, frame.boxes, frame.labels, self.settings.auxiliary_matches)
        if self.settings.denoising:
            losses |= self._denoising_losses(frame.boxes, caches, window, generator)
        with self._autocast():
            maps = self.model.segment_map(features)
        losses |= map_losses({name: logits.float() for name, logits in maps.items()}, frame.maps, frame.map_known)
        return losses | self._supervision_losses(features, frame)

    def _supervision_losses(self, features: FrameFeatures, frame: TrainingFrame) -> Losses:
        """The losses of the supervision heads."""
        losses: Losses = {}
        for head in self.heads:
            assert isinstance(head, PVSupervisionHead | BEVSupervisionHead)
            with self._autocast():
                maps = head(features)
            losses |= head.losses(maps.float(), frame)
        return losses

    def _denoising_losses(
        self, boxes: Tensor, caches: list[FrameCache], window: Window, generator: torch.Generator
    ) -> Losses:
        """The losses of the denoising queries, averaged over the groups; zero for a frame without objects."""
        config = self.model.config
        if not len(boxes):
            return {f"denoised_{layer}": boxes.new_zeros(()) for layer in range(config.num_layers)}
        groups = []
        for _ in range(self.settings.denoising):
            shuffled = shuffle_boxes(boxes, generator, twice=config.queries == "unshared")
            content, pose = denoising_queries(self.model.queries.content, shuffled, generator)
            groups.append(denoising_losses(self.model.decoder(content, pose, caches, window), shuffled))
        return _mean(groups)

    def _mask_images(self, images: Tensor) -> Tensor:
        """Apply GridMask to the images (N, H, W, 3) of one frame, with the mean colour as the fill."""
        if not self.settings.grid_mask:
            return images
        self._grid_mask.set_epoch(self.step, self.settings.steps)
        image = self.model.config.image
        mean = torch.tensor(image.mean)
        # The images are BGR. The configured mean is in the channel order of the encoder.
        return self._grid_mask(images, self._generator("mask"), mean.flip(0) if image.colour_order == "rgb" else mean)

    def _generator(self, purpose: Literal["mask", "noise"]) -> torch.Generator:
        """A random generator for this step. Its seed depends only on the training seed, the step and the purpose."""
        number = self.settings.seed * self.settings.steps + self.step
        return torch.Generator().manual_seed(2 * number + (purpose == "noise"))

    def _autocast(self) -> torch.autocast:
        dtype = torch.float16 if self.settings.amp == "float16" else torch.bfloat16
        return torch.autocast(self.device.type, dtype, enabled=self.settings.amp != "off")

    def state_dict(self) -> dict[str, object]:
        """Everything that the next step depends on."""
        return {
            "step": self.step,
            "model": self.model.state_dict(),
            "heads": self.heads.state_dict(),
            "optimiser": self.optimiser.state_dict(),
        }

    def load_state_dict(self, state: dict) -> None:
        """Restore the state that `state_dict` returned, of a trainer with the same settings."""
        self.step = state["step"]
        self.model.load_state_dict(state["model"])
        self.heads.load_state_dict(state["heads"])
        self.optimiser.load_state_dict(state["optimiser"])


def _mean(losses: list[Losses]) -> Losses:
    return {name: torch.stack([part[name] for part in losses]).mean() for name in losses[0]}


def _make_heads(config: DuoSpaceNetConfig, settings: Settings) -> nn.ModuleList:
    """The supervision heads with random weights from the seed. torch's global generator is left unchanged."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(settings.seed)
        heads = nn.ModuleList()
        if settings.pv_supervision:
            heads.append(PVSupervisionHead(config))
        if settings.bev_supervision and config.has_bev and not settings.pretraining:
            heads.append(BEVSupervisionHead(config))
        return heads


def _set_batch_norm_momentum(model: nn.Module) -> None:
    for module in model.modules():
        if isinstance(module, (nn.BatchNorm2d, nn.BatchNorm3d)):
            module.momentum = BATCH_NORM_MOMENTUM
