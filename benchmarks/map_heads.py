"""Map heads: train the map segmentation of trained weights on fixed BEV features. The other parts do not change.

    python -m benchmarks.map_heads weights/nano.safetensors out/nano.safetensors --preset nano

`train` computes the map segmentation of one frame at a time, so its BatchNorm layers learn with the statistics of
single frames. In evaluation they use the statistics of all frames. Here they learn with those of a batch of frames. The
BEV features are computed once, so that a step costs little.
"""

import argparse
import json
import math
from pathlib import Path

import torch
from safetensors import safe_open
from torch import Tensor, nn

from duospacenet.model import PRESETS, DuoSpaceNet
from duospacenet.training.losses.frame_losses import map_losses
from duospacenet.training.samples.synthetic_clips import SyntheticClips
from duospacenet.training.samples.training_frames import TrainingFrame
from duospacenet.training.settings import Settings
from duospacenet.weights import load_checkpoint, save_checkpoint
from duospacenet.weights.content_hash import HASH_KEY

from .rendered_clips import RenderedClips

CLIPS_SEED = 500  # not of a round of `nano`
FRAMES_PER_CLIP = 6
STEPS = 300
BATCH_SIZE = 6
LEARNING_RATE = 5e-4
WARMUP_STEPS = 20
BATCH_NORM_MOMENTUM = 0.02
LOSSES = Settings(map_dice_weight=3.0)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("weights", type=Path, help="trained weights")
    parser.add_argument("out", type=Path, help="the new weights")
    parser.add_argument("--preset", default="nano")
    parser.add_argument("--clips", type=int, default=100, help=f"training clips of {FRAMES_PER_CLIP} frames")
    parser.add_argument("--folder", type=Path, help="folder of rendered clips; by default beside the new weights")
    parser.add_argument("--workers", type=int, default=2, help="processes that render")
    options = parser.parse_args()
    model = DuoSpaceNet(PRESETS[options.preset]).eval()
    load_checkpoint(options.weights, model)
    clips = SyntheticClips(CLIPS_SEED, FRAMES_PER_CLIP, model.config.voxels.size[:2])
    folder = options.folder or options.out.parent / "clips"
    rendered = RenderedClips(folder, clips, options.clips, held_out=())
    rendered.render(model.config, options.workers)
    frames = [frame for number in range(options.clips) for frame in rendered.clip(number)]
    features = [bev_features(model, frame) for frame in frames]
    train_segmentation(model, features, frames)
    with safe_open(options.weights, "pt") as file:
        metadata = {name: value for name, value in (file.metadata() or {}).items() if name != HASH_KEY}
    round_ = {"steps": STEPS, "batch_size": BATCH_SIZE, "learning_rate": LEARNING_RATE, "data": clips.identity}
    save_checkpoint(options.out, model, metadata | {"map_heads": json.dumps(round_ | {"clips": options.clips})})


@torch.no_grad()
def bev_features(model: DuoSpaceNet, frame: TrainingFrame) -> Tensor:
    """The BEV features (1, C, X, Y) of a frame, in float16."""
    pv = model.image_encoder(frame.images)
    tables = model.projector(frame.image_T_ego, frame.camera_valid)
    return model.divergence_enhancement(model.lifter(model.lifter.reduce(pv), tables)).half()


def train_segmentation(
    model: DuoSpaceNet, features: list[Tensor], frames: list[TrainingFrame], steps: int = STEPS
) -> None:
    """Train the map segmentation of a model, in place. It is in evaluation mode before and after.

    features: the BEV features of each frame.
    """
    segmentation = model.segmentation.train()
    for module in segmentation.modules():
        if isinstance(module, nn.BatchNorm2d):
            module.momentum = BATCH_NORM_MOMENTUM
    optimiser = torch.optim.AdamW(segmentation.parameters(), LEARNING_RATE, weight_decay=0.01)
    schedule = torch.optim.lr_scheduler.LambdaLR(optimiser, lambda step: learning_rate_factor(step, steps))
    generator, order = torch.Generator().manual_seed(0), list[int]()
    for step in range(steps):
        while len(order) < BATCH_SIZE:
            order += torch.randperm(len(frames), generator=generator).tolist()
        batch, order = order[:BATCH_SIZE], order[BATCH_SIZE:]
        logits = segmentation(torch.cat([features[index] for index in batch]).float())
        losses = [
            loss
            for row, index in enumerate(batch)
            for loss in map_losses(
                {name: mask[row : row + 1] for name, mask in logits.items()},
                frames[index].maps,
                frames[index].map_known,
                LOSSES,
            ).values()
        ]
        total = torch.stack(losses).sum() / len(batch)
        optimiser.zero_grad()
        total.backward()
        optimiser.step()
        schedule.step()
        if (step + 1) % 50 == 0:
            print(f"step {step + 1} of {steps}, loss {total.item():.3f}", flush=True)
    segmentation.eval()


def learning_rate_factor(step: int, steps: int) -> float:
    """Linear warm-up, then a cosine to 0."""
    return min(1.0, (step + 1) / WARMUP_STEPS) * 0.5 * (1 + math.cos(math.pi * step / steps))


if __name__ == "__main__":
    main()
