"""A table of what each part of DuoSpaceNet is worth on the drawn world: every row of the paper's ablation
tables, trained on the same drives for as many steps, from several seeds, and judged on drives that no training sees.
All rows begin with one image encoder, which was pre-trained on these drives; how the paper's ablations begin, it does
not say. All have the head on PV features, denoising and hybrid matching beside them; none has the head on BEV features.

    python tests/ablation_scores.py out/ablation-scores --seeds 0 1 2
    python tests/ablation_scores.py docs --seeds              # trains nothing: the table of what was measured

A row's scores of a seed are a line of OUT/ablation-scores.jsonl, and a row that is there with the same settings is not
trained again. What may be found out in an hour on two cores is less than the paper's: the networks are small, and so
are the pictures.
"""

import argparse
import hashlib
import json
import statistics
from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from pathlib import Path

import torch
from torch import Tensor

from duospacenet.evaluation import Sample, evaluate
from duospacenet.export.graphs import build_graphs
from duospacenet.export.manifest_builder import build_manifest
from duospacenet.export.parity.eager_stream import EagerStream
from duospacenet.model import DuoSpaceNet
from duospacenet.model.config import DuoSpaceNetConfig, VoxelGrid
from duospacenet.model.presets import PRESETS, ablate
from duospacenet.runtime.bundle.manifest import GraphName
from duospacenet.runtime.files import atomic_path
from duospacenet.runtime.frame import Frame
from duospacenet.synthetic.drive import SyntheticDrive
from duospacenet.training import Settings, Trainer, initialise
from duospacenet.training.clip_loader import load_clips
from duospacenet.training.clips import SyntheticClips
from duospacenet.training.initial_anchors import find_initial_anchors
from duospacenet.training.training_frames import Clip
from duospacenet.weights import load_checkpoint, save_checkpoint
from duospacenet.weights.input_contract import preprocessing
from duospacenet.weights.provenance import random_weights
from tests.helpers.ablation_rows import TABLES

SIZE = replace(
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
NUM_DRIVES = 192  # that all rows are trained on
FRAMES = 6
DRAWN = SyntheticClips(0, FRAMES, SIZE.voxels.size[:2])
HELD_OUT = [(seed, 12) for seed in range(200, 208)]  # `synthetic:SEED:FRAMES`
PRETRAINING = Settings(
    steps=2500, frames_per_clip=FRAMES, learning_rate=1.2e-3, backbone_learning_rate=1.2e-3, pretraining=True
)
TRAINING = Settings(
    steps=1000,
    batch_size=1,  # what is young learns by steps, not by their exactness
    frames_per_clip=FRAMES,
    learning_rate=6e-4,
    backbone_learning_rate=2e-4,
    warmup_steps=50,
    auxiliary_matches=3,
    bev_supervision=False,  # not every row has BEV features
)
SCORES = ("mAP", "NDS", "mAVE", "drivable_area", "lane_boundary")
SCORES_NAME = "ablation-scores.jsonl"
PAPER = {  # mAP and NDS on nuScenes, "Ablation Studies"; all but the last table of single frames, it seems
    "duo space features": {"bev-no-fde": (0.203, 0.264), "pv": (0.212, 0.261), "no-fde": (0.216, 0.288)},
    "feature divergence enhancement": {
        "bev-no-fde": (0.203, 0.264),
        "bev": (0.210, 0.260),
        "no-fde": (0.216, 0.288),
        "": (0.229, 0.294),
    },
    "duo space queries": {"unshared": (0.202, 0.252), "shared-content": (0.225, 0.290), "": (0.229, 0.294)},
    "temporal strategies": {"stacking": (0.236, 0.337), "attention": (0.243, 0.340), "": (0.266, 0.385)},
}

Scores = dict[str, float | None]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("out", type=Path)
    parser.add_argument("--steps", type=int, default=TRAINING.steps)
    parser.add_argument("--seeds", type=int, nargs="*", default=[0, 1])
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    path = options.out / SCORES_NAME
    torch.set_num_threads(1)  # the operators are small; a second process may train other seeds
    training = replace(TRAINING, steps=options.steps)
    settings = digest_of(training)
    encoder = options.out / f"encoder-{digest(SIZE, DRAWN.identity, NUM_DRIVES, PRETRAINING)}.safetensors"
    if not options.seeds and not read_runs(path, settings):
        parser.error(f"{path}: expected runs with the settings {settings}; got none. Train with --seeds 0 1.")
    for seed in options.seeds:
        for row in dict.fromkeys(row for table in TABLES.values() for row in table):
            if (row, seed) not in read_runs(path, settings):
                scores = train_and_judge(row, replace(training, seed=seed), encoder)
                line = json.dumps({"row": row, "seed": seed, "steps": options.steps, "settings": settings} | scores)
                with path.open("a") as file:
                    file.write(line + "\n")
                print(line, flush=True)
    print_table(read_runs(path, settings))


def digest_of(training: Settings) -> str:
    """Of all that decides a row's scores but its seed."""
    return digest(SIZE, DRAWN.identity, NUM_DRIVES, HELD_OUT, PRETRAINING, training)


def digest(*settings: object) -> str:
    """A name for settings, by what they print as."""
    return hashlib.sha256(repr(settings).encode()).hexdigest()[:8]


def read_runs(path: Path, settings: str) -> dict[tuple[str, int], Scores]:
    """The scores that were measured with these settings, by row and seed."""
    runs = map(json.loads, path.read_text().splitlines() if path.exists() else [])
    return {(run["row"], run["seed"]): run for run in runs if run.get("settings") == settings}


def print_table(runs: dict[tuple[str, int], Scores]) -> None:
    """What README's table is made from, with the paper's numbers beside ours."""
    columns = ("table", "row", "paper: mAP", "NDS", "here: seeds", *SCORES)
    print(f"| {' | '.join(columns)} |\n{'| --- ' * len(columns)}|")
    for table, members in TABLES.items():
        for row in members:
            ours = [scores for (of, _), scores in runs.items() if of == row]
            cells = (spread([run[score] for run in ours]) for score in SCORES)
            paper = " | ".join(f"{score:.3f}" for score in PAPER[table][row])
            print(f"| {table} | `{row or 'whole'}` | {paper} | {len(ours)} | {' | '.join(cells)} |")


@cache
def drives() -> list[Clip]:
    """The same for all rows; in memory, for drawing takes longer than training does at this size."""
    return list(load_clips(DRAWN, SIZE, preprocessing(SIZE), range(NUM_DRIVES), 0))


@cache
def held_out() -> list[list[Frame]]:
    return [list(SyntheticDrive(seed, frames, grid=SIZE.voxels.size[:2])) for seed, frames in HELD_OUT]


@cache
def anchors() -> Tensor:
    """The same for all rows, which have as many queries."""
    return find_initial_anchors(DRAWN, SIZE.num_queries, seed=0)


def train_and_judge(row: str, settings: Settings, encoder: Path) -> Scores:
    """encoder: the file of the image encoder that all rows begin with; it is pre-trained where there is none."""
    if not encoder.exists():
        pretrain(encoder)
    model = initialise(DuoSpaceNet(ablate(SIZE, row) if row else SIZE), settings.seed, anchors())
    load_checkpoint(encoder, model.image_encoder)
    train(model, settings)
    return judge(model)


def pretrain(encoder: Path) -> None:
    model = initialise(DuoSpaceNet(SIZE), 0)
    train(model, PRETRAINING)
    with atomic_path(encoder) as temporary:
        save_checkpoint(temporary, model.image_encoder)


def train(model: DuoSpaceNet, settings: Settings) -> None:
    """In the order that the seed gives; of the maps a model learns those that it draws."""
    trainer = Trainer(model, settings, torch.device("cpu"))
    order = torch.Generator().manual_seed(settings.seed)
    num_maps = len(model.config.map_classes)
    while trainer.step < settings.steps:
        places = torch.randint(NUM_DRIVES, (settings.batch_size,), generator=order).tolist()
        group = [[sample._replace(maps=sample.maps[:num_maps]) for sample in drives()[place]] for place in places]
        for _ in trainer.train_on(group):
            pass


def judge(model: DuoSpaceNet) -> Scores:
    report = evaluate(answers(model))
    scores = {"mAP": report.mean_average_precision, "NDS": report.nds, "mAVE": report.mean_errors["velocity"]}
    return scores | {name: report.map_iou.get(name) for name in SCORES[3:]}


def answers(model: DuoSpaceNet) -> Iterator[Sample]:
    config: DuoSpaceNetConfig = model.config
    graphs = build_graphs(model)
    unwritten: dict[GraphName, str] = dict.fromkeys((graph.name for graph in graphs), "")
    stream = EagerStream(model, build_manifest(config, random_weights(model, 0), graphs, unwritten))
    for drive in held_out():
        stream.reset()
        for frame in drive:
            with torch.no_grad():
                detections = stream.step(frame)
            assert frame.ground_truth is not None
            yield Sample(detections, frame.ground_truth)


def spread(values: list[float | None]) -> str:
    """The mean, and how far the seeds lie apart (the standard deviation)."""
    known = [value for value in values if value is not None]
    if not known:
        return "-"
    deviation = f" ± {statistics.stdev(known):.3f}" if len(known) > 1 else ""
    return f"{statistics.mean(known):.3f}{deviation}"


if __name__ == "__main__":
    main()
