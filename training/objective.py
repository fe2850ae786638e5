"""The training objective: a model with its supervision heads, and all losses of a batch of frames."""

from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext

import torch
from torch import Tensor, nn

from ..model import DuoSpaceNet, DuoSpaceNetConfig
from ..model.decoder import FrameCache, Prediction
from ..model.duospacenet import FrameFeatures
from ..model.window import Window
from .activation_checkpointing import has_checkpoints
from .batched_detection import DecoderInputs, detect_batch
from .encoded_frames import EncodedFrame, decoder_inputs
from .losses.bev_supervision import BEVSupervisionHead
from .losses.denoising import denoising_losses, denoising_queries, shuffle_boxes
from .losses.frame_losses import Losses, detection_losses, map_losses
from .losses.pv_supervision import PVSupervisionHead
from .random_numbers import random_generator, random_seed
from .sampled_clip import Sample
from .samples.grid_mask import GridMask
from .samples.training_frames import TrainingFrame
from .settings import Settings
from .tasks import parts_without_loss, trained_tasks, untrained_modules


class Objective(nn.Module):
    """Computes all losses of a batch. Parameters that no loss depends on get `requires_grad=False`.

    Call `checkpoint_activations` before.

    loss_names: the names of the losses, which depend on the settings only.
    """

    def __init__(self, model: DuoSpaceNet, settings: Settings) -> None:
        super().__init__()
        self.model = model
        self.heads = make_heads(model.config, settings)
        self.settings = settings
        self.tasks = trained_tasks(settings, model.config)
        self.loss_names = loss_names(model.config, settings)
        self._has_bev = model.config.has_bev and "lifter" not in parts_without_loss(settings, model.config)
        self._grid_mask = GridMask(settings.grid_mask)
        # The random numbers, or the second computation, of a window would depend on the other windows.
        self._detects_together = not settings.dropout and not has_checkpoints(model)
        for module in _modules_without_loss(model, settings):
            module.requires_grad_(False)
        for module in model.modules():
            if isinstance(module, nn.Dropout):
                module.p = settings.dropout

    def forward(self, samples: list[Sample], step: int) -> tuple[Tensor, list[FrameFeatures]]:
        """Compute the losses, summed over the samples.

        samples: any number; without samples the losses are 0.
        step: the number of the step, for the random numbers.

        Returns the losses (K) in the order of `loss_names`, and the features of each sample, detached. Every parameter
        that needs a gradient gets one, which is 0 for parameters that these samples do not use. (Otherwise
        DistributedDataParallel would wait for the gradients of the other parameters.)
        """
        past = [self._past(sample, step) for sample in samples]
        encoded = self.encode([sample.frame for sample in samples], step, [sample.clip for sample in samples])
        histories = [[newest, *older] for newest, older in zip(encoded, past, strict=True)]
        inputs = [self._decoder_inputs(history) for history in histories]
        predictions = self._detect_together(inputs)
        losses = [self._losses(*each, step) for each in zip(samples, histories, inputs, predictions, strict=True)]
        total = self._sum(losses)
        if any(all(name not in part for part in losses) for name in self.loss_names):
            total = total + self._zero()
        return total, [newest.detached().features for newest in encoded]

    def encode(self, frames: list[TrainingFrame], step: int, clips: list[int], age: int = 0) -> list[EncodedFrame]:
        """Compute the features of frames. The image encoder gets the images of all frames in one batch.

        clips: the number of each frame's clip. age: 0 for the newest frames of samples, 1 for the frames before them.
        """
        if not frames:
            return []
        images = torch.cat(
            [self._mask(frame.images, step, clip, age) for frame, clip in zip(frames, clips, strict=True)]
        )
        with self._autocast(images):
            levels = self.model.image_encoder(images)
        # The other parts take one frame at a time, because the projection of each frame differs.
        by_frame = zip(*(level.float().split(self.model.config.num_cameras) for level in levels), strict=True)
        return [EncodedFrame(frame, self._lift(list(pv), frame)) for pv, frame in zip(by_frame, frames, strict=True)]

    @torch.no_grad()
    def _past(self, sample: Sample, step: int) -> list[EncodedFrame]:
        """The past frames of a sample. Frames without features are encoded with the current weights, one at a time."""
        encoded: list[EncodedFrame] = []
        for age, frame in enumerate(sample.past, start=1):
            encoded += [frame] if isinstance(frame, EncodedFrame) else self.encode([frame], step, [sample.clip], age)
        return encoded

    def _lift(self, pv: list[Tensor], frame: TrainingFrame) -> FrameFeatures:
        if not self._has_bev:
            return FrameFeatures(pv, None)
        # The lifter computes in float32: rounding to bfloat16 would move sampling locations by several pixels.
        tables = self.model.projector(frame.image_T_ego, frame.camera_valid)
        voxels = self.model.lifter(self.model.lifter.reduce(pv), tables)
        with self._autocast(voxels):
            bev = self.model.divergence_enhancement(voxels)
        return FrameFeatures(pv, bev.float())

    def _decoder_inputs(self, history: list[EncodedFrame]) -> DecoderInputs | None:
        """The decoder's inputs for a frame and its past frames; None if no loss of this frame needs the decoder."""
        needed = self.tasks.detection and not self.settings.pretraining and history[0].frame.boxes_known
        return decoder_inputs(self.model, history) if needed else None

    def _detect_together(self, inputs: list[DecoderInputs | None]) -> list[list[Prediction] | None]:
        """The predictions of the samples that are detected together, None for the others.

        They are the samples on a GPU with windows of equal length. With dropout or activation checkpointing there are
        none.
        """
        by_length: dict[int, dict[int, DecoderInputs]] = {}
        for index, each in enumerate(inputs):
            if self._detects_together and each is not None and each[1].past_T_now.is_cuda:
                by_length.setdefault(len(each[0]), {})[index] = each
        predictions: list[list[Prediction] | None] = [None] * len(inputs)
        for together in by_length.values():
            for index, prediction in zip(together, detect_batch(self.model, [*together.values()]), strict=True):
                predictions[index] = prediction
        return predictions

    def _losses(
        self,
        sample: Sample,
        history: list[EncodedFrame],
        inputs: DecoderInputs | None,
        predictions: list[Prediction] | None,
        step: int,
    ) -> Losses:
        """All losses of a sample. A loss without its ground truth is left out.

        history: the encoded frame of the sample, then its past frames.
        inputs: the decoder's inputs, if the decoder is needed.
        predictions: the predictions for these inputs, if they are known already.
        """
        frame, features = history[0]
        losses: Losses = {}
        if self.tasks.detection and frame.boxes_known:
            if inputs is not None:
                with self._random_dropout(frame.boxes.device, step, sample.clip):
                    losses |= self._detection_losses(sample, inputs, predictions, step)
            losses |= self._supervision_losses(features, frame)
        if self.tasks.maps:
            with self._autocast(frame.images):
                maps = self.model.segment_map(features)
            logits = {name: values.float() for name, values in maps.items()}
            losses |= map_losses(logits, frame.maps, frame.map_known, self.settings)
        return losses

    def _detection_losses(
        self, sample: Sample, inputs: DecoderInputs, predictions: list[Prediction] | None, step: int
    ) -> Losses:
        frame, settings = sample.frame, self.settings
        caches, window = inputs
        predictions = self.model.detect(caches, window) if predictions is None else predictions
        losses = detection_losses(predictions, frame.boxes, frame.labels, settings, self.model.config.classes)
        losses = {name: sample.weight * loss for name, loss in losses.items()}
        if settings.denoising:
            generator = random_generator("denoising", settings.seed, step, sample.clip)
            losses |= self._denoising_losses(frame.boxes, caches, window, generator)
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
            predictions = self.model.decoder(content, pose, caches, window)
            groups.append(denoising_losses(predictions, shuffled, self.settings))
        return {name: torch.stack([group[name] for group in groups]).mean() for name in groups[0]}

    def _supervision_losses(self, features: FrameFeatures, frame: TrainingFrame) -> Losses:
        """The losses of the supervision heads."""
        losses: Losses = {}
        for head in self.heads:
            assert isinstance(head, PVSupervisionHead | BEVSupervisionHead)
            with self._autocast(frame.images):
                maps = head(features)
            losses |= head.losses(maps.float(), frame)
        return losses

    def _sum(self, losses: list[Losses]) -> Tensor:
        """The sums (K) of the losses of several frames, in the order of `loss_names`."""
        zero = next(self.parameters()).new_zeros(())
        rows = [torch.stack([part.get(name, zero) for name in self.loss_names]) for part in losses]
        return torch.stack(rows).sum(dim=0) if rows else zero.expand(len(self.loss_names))

    def _zero(self) -> Tensor:
        """Zero, with a gradient of zero for every trained parameter."""
        firsts = [parameter.flatten()[:1] for parameter in self.parameters() if parameter.requires_grad]
        return 0.0 * torch.cat(firsts).sum()

    def _mask(self, images: Tensor, step: int, clip: int, age: int) -> Tensor:
        """Apply GridMask to the images (N, H, W, 3) of one frame, with the mean colour as the fill."""
        settings = self.settings
        if not settings.grid_mask:
            return images
        if settings.grid_mask_ramp:
            self._grid_mask.set_epoch(step, settings.steps)
        image = self.model.config.image
        mean = torch.tensor(image.mean)
        generator = random_generator("grid mask", settings.seed, step, clip, age)
        # The images are BGR. The configured mean is in the channel order of the encoder.
        return self._grid_mask(images, generator, mean.flip(0) if image.colour_order == "rgb" else mean)

    def _random_dropout(self, device: torch.device, step: int, clip: int) -> AbstractContextManager:
        """Seed the dropout in the block by step and clip, through torch's generator: nn.Dropout takes no other."""
        if not self.settings.dropout:
            return nullcontext()
        return _seeded(random_seed("dropout", self.settings.seed, step, clip), device)

    def _autocast(self, tensor: Tensor) -> torch.autocast:
        dtype = torch.float16 if self.settings.amp == "float16" else torch.bfloat16
        return torch.autocast(tensor.device.type, dtype, enabled=self.settings.amp != "off")


def loss_names(config: DuoSpaceNetConfig, settings: Settings) -> tuple[str, ...]:
    """The names of all losses of a model with these settings."""
    tasks = trained_tasks(settings, config)
    names: list[str] = []
    if tasks.detection and not settings.pretraining:
        names += [f"{loss}_{layer}" for layer in range(config.num_layers) for loss in ("class", "box")]
        names += [f"denoised_{layer}" for layer in range(config.num_layers) if settings.denoising]
    if tasks.maps:
        names += [f"{loss}_{name}" for name in config.map_classes for loss in ("focal", "dice")]
    for head in _head_types(config, settings):
        names += head.loss_names
    return tuple(names)


def make_heads(config: DuoSpaceNetConfig, settings: Settings) -> nn.ModuleList:
    """The supervision heads with random weights from the seed. torch's global generator is left unchanged."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(settings.seed)
        return nn.ModuleList(head(config) for head in _head_types(config, settings))


def _head_types(
    config: DuoSpaceNetConfig, settings: Settings
) -> list[type[PVSupervisionHead] | type[BEVSupervisionHead]]:
    """The supervision heads of these settings. They learn from boxes, so a training of the maps alone has none.

    Nor is there a head for features that do not change, because the parts that compute them are frozen.
    """
    if not trained_tasks(settings, config).detection:
        return []
    heads: list[type[PVSupervisionHead] | type[BEVSupervisionHead]] = []
    if settings.pv_supervision and "image_encoder" not in settings.frozen_parts:
        heads.append(PVSupervisionHead)
    changes_bev = not {"image_encoder", "lifter", "divergence_enhancement"}.issubset(settings.frozen_parts)
    if settings.bev_supervision and config.has_bev and changes_bev and not settings.pretraining:
        heads.append(BEVSupervisionHead)
    return heads


def _modules_without_loss(model: DuoSpaceNet, settings: Settings) -> list[nn.Module]:
    modules = list(untrained_modules(model, settings).values())
    if settings.pretraining:  # the PV supervision learns on the finest level only
        modules += [*model.image_encoder.neck.output[1:], model.image_encoder.neck.extra]
    return modules


@contextmanager
def _seeded(seed: int, device: torch.device) -> Iterator[None]:
    """Seed torch's global generators for the block, and restore their states after it."""
    with torch.random.fork_rng(devices=[] if device.type == "cpu" else [device], device_type=device.type):
        torch.manual_seed(seed)
        yield
