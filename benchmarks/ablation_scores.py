"""Train and evaluate every row of the paper's ablation tables on synthetic clips, and print the scores as a table.

    python -m benchmarks.ablation_scores out/ablation-scores --seeds 0 1 2
    python -m benchmarks.ablation_scores docs --seeds    # trains nothing: prints the table of the recorded runs

All rows train on the same clips for the same number of steps, and are evaluated on held-out drives. They start from one
image encoder that was pretrained on these clips. (The paper does not say what its ablations start from.) Denoising
queries, hybrid matching and PV supervision are on in all rows; BEV supervision is off.

Each run of a row and a seed is a line of OUT/ablation-scores.jsonl. A run that is recorded with the same settings is
not repeated. The models and images are small, so that all rows of one seed take about two hours on one core.
"""

import argparse
import hashlib
import json
import statistics
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path

import torch
from torch import Tensor

from duospacenet.evaluation import Sample, evaluate
from duospacenet.export.parity.eager_stream import EagerStream
from duospacenet.model import DuoSpaceNet
from duospacenet.model.config import VoxelGrid
from duospacenet.model.presets import PRESETS, ablate
from duospacenet.runtime.files import atomic_path
from duospacenet.runtime.frame import Frame
from duospacenet.synthetic.drive import SyntheticDrive
from duospacenet.training import Settings, Trainer, initialise
from duospacenet.training.initial_anchors import find_initial_anchors
from duospacenet.training.samples.clip_loader import load_clips
from duospacenet.training.samples.synthetic_clips import SyntheticClips
from duospacenet.training.samples.training_frames import Clip
from duospacenet.weights import load_checkpoint, save_checkpoint
from duospacenet.weights.input_contract import preprocessing

from .ablation_tables import ABLATION_ROWS, ABLATION_TABLES

FULL_MODEL = replace(
    PRESETS["nano"],
    preset="ablated",
    image=replace(PRESETS["nano"].image, width_px=240, height_px=96),
    backbone=replace(PRESETS["nano"].backbone, width=16),
    voxels=VoxelGrid((32, 32, 4)),
    num_queries=128,
    channels=64,
    voxel_channels=16,
    segmentation_channels=16,
    feedforward_channels=256,
)
GRID = FULL_MODEL.voxels.size[:2]
NUM_CLIPS = 192
FRAMES_PER_CLIP = 6
CLIPS = SyntheticClips(seed=0, num_frames=FRAMES_PER_CLIP, grid=GRID)
HELD_OUT = [(seed, 12) for seed in range(200, 208)]  # seed and number of frames of each drive
PRETRAINING = Settings(
    steps=2500,
    frames_per_clip=FRAMES_PER_CLIP,
    learning_rate=1.2e-3,
    backbone_learning_rate=1.2e-3,
    pretraining=True,
)
TRAINING = Settings(
    steps=1000,
    batch_size=1,  # in a short training, more steps help more than larger batches
    frames_per_clip=FRAMES_PER_CLIP,
    learning_rate=6e-4,
    backbone_learning_rate=2e-4,
    warmup_steps=50,
    warmup_start=0.02,
    auxiliary_matches=3,
    bev_supervision=False,  # one row has no BEV features
)
DETECTION_SCORES = ("mAP", "NDS", "mAVE")
MAP_SCORES = ("drivable_area", "lane_boundary")
SCORES = (*DETECTION_SCORES, *MAP_SCORES)
SCORES_NAME = "ablation-scores.jsonl"

Scores = dict[str, float | None]  # None: the row has no such score
Runs = dict[tuple[str, int], Scores]  # by row and seed


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("out", type=Path, help=f"folder of {SCORES_NAME}")
    parser.add_argument("--steps", type=int, default=TRAINING.steps, help="training steps of each run")
    parser.add_argument("--seeds", type=int, nargs="*", default=[0, 1], help="none: print the recorded runs")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    torch.set_num_threads(1)  # the operators are too small for more; use the other cores for other seeds
    path = options.out / SCORES_NAME
    training = replace(TRAINING, steps=options.steps)
    settings_hash = hash_settings(training)
    for seed in options.seeds:
        for row in ABLATION_ROWS:
            if (row, seed) not in read_runs(path, settings_hash):
                scores = run_row(row, replace(training, seed=seed), encoder_path(options.out))
                record_run(path, {"row": row, "seed": seed, "steps": options.steps, "settings": settings_hash} | scores)
    runs = read_runs(path, settings_hash)
    if not runs:
        parser.error(f"{path}: expected runs with the settings {settings_hash}; got none. Train with --seeds 0 1.")
    print_table(runs)


# --- Recorded runs ------------------------------------------------------------------------------------------------


def hash_settings(training: Settings) -> str:
    """The hash of everything that decides the scores of a row, except its seed."""
    return short_hash(
        FULL_MODEL.to_dict(), CLIPS.identity, NUM_CLIPS, HELD_OUT, PRETRAINING.to_dict(), training.to_dict()
    )


def encoder_path(folder: Path) -> Path:
    """The file of the pretrained image encoder; its name has the hash of everything that decides the weights."""
    encoder_hash = short_hash(FULL_MODEL.to_dict(), CLIPS.identity, NUM_CLIPS, PRETRAINING.to_dict())
    return folder / f"encoder-{encoder_hash}.safetensors"


def short_hash(*values: object) -> str:
    return hashlib.sha256(json.dumps(values).encode()).hexdigest()[:8]


def record_run(path: Path, run: dict) -> None:
    """Append a run to the file, and print it."""
    line = json.dumps(run)
    with path.open("a") as file:
        file.write(line + "\n")
    print(line, flush=True)


def read_runs(path: Path, settings_hash: str) -> Runs:
    """The recorded runs with these settings."""
    runs = map(json.loads, path.read_text().splitlines() if path.exists() else [])
    return {(run["row"], run["seed"]): run for run in runs if run.get("settings") == settings_hash}


def print_table(runs: Runs, scores: Sequence[str] = SCORES) -> None:
    """Print a table for docs/results/ablations.md, in Markdown: the scores of the paper and of the runs."""
    columns = ("table", "row", "paper: mAP", "NDS", "here: seeds", *scores)
    print(f"| {' | '.join(columns)} |\n{'| --- ' * len(columns)}|")
    for table, rows in ABLATION_TABLES.items():
        for row, paper_scores in rows.items():
            of_row = [run for (name, _), run in runs.items() if name == row]
            cells = (mean_and_deviation([run[name] for run in of_row]) for name in scores)
            paper = " | ".join(f"{score:.3f}" for score in paper_scores)
            print(f"| {table} | `{row or 'full model'}` | {paper} | {len(of_row)} | {' | '.join(cells)} |")


def mean_and_deviation(values: list[float | None]) -> str:
    """The mean and the standard deviation over the seeds, without those that have no value."""
    known = [value for value in values if value is not None]
    if not known:
        return "-"
    deviation = f" ± {statistics.stdev(known):.3f}" if len(known) > 1 else ""
    return f"{statistics.mean(known):.3f}{deviation}"


# --- Training -----------------------------------------------------------------------------------------------------


def run_row(row: str, settings: Settings, encoder: Path) -> Scores:
    """Train and evaluate a row. encoder: the pretrained image encoder; it is trained first if the file is missing."""
    if not encoder.exists():
        pretrain(encoder)
    model = initialise(DuoSpaceNet(ablate(FULL_MODEL, row) if row else FULL_MODEL), settings.seed, anchors())
    load_checkpoint(encoder, model.image_encoder)
    train(model, settings)
    return evaluate_model(model, held_out_drives())


def pretrain(encoder: Path) -> None:
    model = initialise(DuoSpaceNet(FULL_MODEL), 0)
    train(model, PRETRAINING)
    with atomic_path(encoder) as temporary:
        save_checkpoint(temporary, model.image_encoder)


def train(model: DuoSpaceNet, settings: Settings) -> None:
    """Train on randomly sampled clips."""
    trainer = Trainer(model, settings, torch.device("cpu"))
    generator = torch.Generator().manual_seed(settings.seed)
    num_maps = len(model.config.map_classes)  # a row may have no maps, but the clips have all
    while trainer.step < settings.steps:
        numbers = torch.randint(NUM_CLIPS, (settings.batch_size,), generator=generator).tolist()
        batch = [[frame._replace(maps=frame.maps[:num_maps]) for frame in clips()[number]] for number in numbers]
        for _ in trainer.train_on(batch):
            pass


@cache
def clips() -> list[Clip]:
    """The clips of all rows. They stay in memory, because rendering takes longer than training at this size."""
    return list(load_clips(CLIPS, FULL_MODEL, preprocessing(FULL_MODEL), range(NUM_CLIPS), workers=0))


@cache
def anchors() -> Tensor:
    """The initial anchors of all rows, which have equally many queries."""
    return find_initial_anchors(CLIPS.ground_truth(), FULL_MODEL.num_queries, seed=0)


# --- Evaluation ---------------------------------------------------------------------------------------------------


def evaluate_model(model: DuoSpaceNet, drives: list[list[Frame]]) -> Scores:
    """Evaluate a model in eager mode, on its device."""
    report = evaluate(detect_drives(model, drives))
    scores = {"mAP": report.mean_average_precision, "NDS": report.nds, "mAVE": report.mean_errors["velocity"]}
    return scores | {name: report.map_iou.get(name) for name in MAP_SCORES}


def detect_drives(model: DuoSpaceNet, drives: list[list[Frame]]) -> Iterator[Sample]:
    """Detections and ground truth of all frames."""
    stream = EagerStream(model)
    for frames in drives:
        stream.reset()
        for frame in frames:
            with torch.no_grad():
                detections = stream.step(frame)
            assert frame.ground_truth is not None
            yield Sample.of_detections(detections, frame.ground_truth, frame.global_T_ego)


@cache
def held_out_drives() -> list[list[Frame]]:
    return [list(SyntheticDrive(seed, frames, grid=GRID)) for seed, frames in HELD_OUT]


if __name__ == "__main__":
    main()
