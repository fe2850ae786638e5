"""Ablations from trained weights: rows of the paper's ablation tables that continue the training of `nano`.

    python -m benchmarks.trained_ablations out/ablations --render --workers 16
    python -m benchmarks.trained_ablations out/ablations --row full --measure-rate --device cuda
    python -m benchmarks.trained_ablations out/ablations --row stacking --seed 1 --device cuda
    python -m benchmarks.trained_ablations docs --table    # trains nothing: prints the recorded runs

A row starts from the tensors of the trained `nano`, except those in `NEW`, which start anew in every row: the
parts that differ between the rows, and the parts that use their output. So the full model has no lead over the others.
The image encoder stays as it is, and maps are not trained.
Rows with other queries inherit less, see `NEW_WITH_OTHER_QUERIES`. Compare them with each other only.

The rows train on the same clips. Each process trains one row with one seed, so several can run at the same time. The
seed decides the new tensors and the order of the clips. Each run is a line of OUT/trained-ablation-scores.jsonl.
"""

import argparse
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import torch

from duospacenet.model import DuoSpaceNet
from duospacenet.model.presets import PRESETS, ablate
from duospacenet.runtime.bundle.manifest import sha256
from duospacenet.training import Settings, Trainer, initialise
from duospacenet.training.samples.synthetic_clips import SyntheticClips
from duospacenet.training.trainer import TrainingStep
from duospacenet.weights import load_checkpoint
from duospacenet.weights.checkpoint_report import CheckpointReport
from duospacenet.weights.shipped import shipped_weights

from .ablation_scores import DETECTION_SCORES, evaluate_model, print_table, read_runs, record_run, short_hash
from .ablation_tables import ABLATION_ROWS
from .rendered_clips import RenderedClips

CONFIG = PRESETS["nano"]
FULL = "full"  # the name of the full model on the command line
FRAMES_PER_CLIP = 6
NUM_CLIPS = 400
CLIPS = SyntheticClips(seed=500, num_frames=FRAMES_PER_CLIP, grid=CONFIG.voxels.size[:2])  # not of a round of `nano`
HELD_OUT = tuple((seed, 16) for seed in range(300, 308))  # seed and number of frames of each drive
TRAINING = Settings(
    steps=800,
    batch_size=2,
    frames_per_clip=FRAMES_PER_CLIP,
    learning_rate=6e-4,
    backbone_learning_rate=1e-4,
    warmup_steps=50,
    auxiliary_matches=1,
    denoising=0,
    tasks="detection",
    frozen_parts=("image_encoder",),
)
# Patterns of the tensors that start anew in every row: the BEV branch, with the parts that differ between the rows.
NEW = ("lifter.*", "divergence_enhancement.*", "decoder.layers.*.cross_attention.bev.*", "segmentation.*")
# Rows with other queries have content of another size, so their decoder layers start anew too.
NEW_WITH_OTHER_QUERIES = (*NEW, "queries.content", "decoder.layers.*")
OF_ONE_ROW = ("decoder.bev_fusion.*",)  # not in `nano`
SCORES_NAME = "trained-ablation-scores.jsonl"
RATE_STEPS = 60  # of --measure-rate; the first half is left out
LOG_EVERY = 50  # steps


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("out", type=Path, help=f"folder of {SCORES_NAME} and of the clips")
    action = parser.add_mutually_exclusive_group(required=True)
    action.add_argument("--render", action="store_true", help="render the clips and the held-out drives")
    action.add_argument("--row", choices=[FULL, *filter(None, ABLATION_ROWS)], help="train and evaluate this row")
    action.add_argument("--table", action="store_true", help="print the recorded runs")
    parser.add_argument("--workers", type=int, default=2, help="processes of --render")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--steps", type=int, default=TRAINING.steps, help="training steps of the run")
    parser.add_argument("--clips", type=int, default=NUM_CLIPS, help="number of training clips")
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--weights", type=Path, help="trained weights of nano; by default the shipped ones")
    parser.add_argument("--measure-rate", action="store_true", help=f"only train {RATE_STEPS} steps for the rate")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    rendered = RenderedClips(options.out / "clips", CLIPS, options.clips, HELD_OUT)
    if options.render:
        rendered.render(CONFIG, options.workers)
        return
    weights = options.weights or shipped_weights("nano")
    settings = replace(TRAINING, steps=options.steps, seed=options.seed)
    path, settings_hash = options.out / SCORES_NAME, hash_settings(settings, options.clips)
    if options.table:
        print_table(read_runs(path, settings_hash), DETECTION_SCORES)
        return
    if missing := next(rendered.missing(), None):
        parser.error(f"{missing}: expected rendered clips; it is missing. Run --render first.")
    row = "" if options.row == FULL else options.row
    torch.set_num_threads(1)  # several rows train at the same time
    if options.measure_rate:
        train_row(row, replace(settings, steps=RATE_STEPS), rendered, weights, torch.device(options.device))
        return
    model = train_row(row, settings, rendered, weights, torch.device(options.device))
    scores = evaluate_model(model, rendered.held_out_drives)
    run = {"row": row, "seed": options.seed, "steps": options.steps, "settings": settings_hash}
    record_run(path, run | {"weights": sha256(weights)} | {name: scores[name] for name in DETECTION_SCORES})


def hash_settings(settings: Settings, num_clips: int = NUM_CLIPS) -> str:
    """The hash of everything that decides the scores of a row, except its seed and the weights of `nano`."""
    without_seed = replace(settings, seed=0).to_dict()
    return short_hash(CONFIG.to_dict(), CLIPS.identity, num_clips, HELD_OUT, NEW, NEW_WITH_OTHER_QUERIES, without_seed)


def train_row(
    row: str, settings: Settings, rendered: RenderedClips, weights: Path, device: torch.device
) -> DuoSpaceNet:
    """Train a row and return its model. Prints the rate."""
    model = initialise(DuoSpaceNet(ablate(CONFIG, row) if row else CONFIG), settings.seed)
    report = inherit(model, weights)
    print(f"{row or FULL}, seed {settings.seed}: {len(report.matched)} of {report.num_expected} tensors inherited")
    trainer = Trainer(model, settings, device)
    start, first = time.perf_counter(), 0
    for step in train(trainer, rendered):
        done = step.number + 1
        if done == min(settings.steps // 2, LOG_EVERY):  # the first steps are slower
            start, first = time.perf_counter(), done
        elif done % LOG_EVERY == 0 or done == settings.steps:
            rate = (done - first) / (time.perf_counter() - start)
            left_s = (settings.steps - done) / rate
            print(
                f"{row or FULL}, seed {settings.seed}: step {done} of {settings.steps}, loss "
                f"{step.losses['total']:.2f}, {rate:.2f} steps/s, {left_s:.0f} s left",
                flush=True,
            )
    return trainer.model.eval()


def inherit(model: DuoSpaceNet, weights: Path) -> CheckpointReport:
    """Load the tensors of the trained `nano` that the row inherits. The others keep their values."""
    new = NEW if model.config.queries == CONFIG.queries else NEW_WITH_OTHER_QUERIES
    return load_checkpoint(weights, model, allow_missing=[*new, *OF_ONE_ROW], ignore=new)


def train(trainer: Trainer, rendered: RenderedClips) -> Iterator[TrainingStep]:
    """Train on all clips, in an order that the seed decides; again in another order if there are more steps."""
    settings, config = trainer.settings, trainer.model.config
    generator = torch.Generator().manual_seed(settings.seed)
    num_maps = len(config.map_classes)  # a row may have no maps, but the clips have all
    while trainer.step < settings.steps:
        order = torch.randperm(rendered.num_clips, generator=generator)
        for numbers in order.split(settings.batch_size)[: rendered.num_clips // settings.batch_size]:
            clips = [rendered.clip(number) for number in numbers.tolist()]
            yield from trainer.train_on(
                [
                    [frame._replace(maps=frame.maps[:num_maps], map_known=frame.map_known[:num_maps]) for frame in clip]
                    for clip in clips
                ]
            )
            if trainer.step == settings.steps:
                return


if __name__ == "__main__":
    main()
