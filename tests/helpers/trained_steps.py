"""A short training of the tiny model on its part of fixed batches, in one process or in several.

`python -m tests.helpers.trained_steps FOLDER` joins the other processes and writes its results to FOLDER/HISTORY.RANK.
"""

import sys
from typing import Any

import torch

from duospacenet.training import Trainer
from duospacenet.training.distributed import Processes, join_processes
from duospacenet.training.samples.training_frames import Clip
from tests.helpers.trainings import new_trainer, settings_with, synthetic_training_frames

HISTORIES = ("stream", "windows")


def fixed_batches(history: str) -> list[list[Clip]]:
    """Two batches of four clips. With "stream", the last two clips are shorter, so that one process has none left."""
    lengths = (2, 2, 1, 1) if history == "stream" else (2, 3, 1, 2)
    return [
        [synthetic_training_frames(seed + 4 * batch, 3)[:length] for seed, length in enumerate(lengths, start=1)]
        for batch in range(2)
    ]


def trained_steps(history: str, processes: Processes, accumulation_steps: int = 1) -> dict[str, Any]:
    """The losses of each step, the gradient of the first, and the weights before and after the training."""
    settings = settings_with(
        steps=6,
        batch_size=4,
        history=history,
        # Without these, the statistics of the image encoder are those of a process's part.
        backbone_norm_eval=history == "stream",
        norm_eval=history == "windows",
        grid_mask=0.5,
        loss_average="batch",
        ema_decay=0.9,
    )
    trainer: Trainer = new_trainer(settings, processes=processes, accumulation_steps=accumulation_steps)
    start = parameters(trainer)
    gradient: dict[str, torch.Tensor] = {}
    steps = []
    for batch in fixed_batches(history):
        own = batch[processes.rank * trainer.local_batch_size :][: trainer.local_batch_size]
        for step in trainer.train_on(own, [len(clip) if history == "stream" else 1 for clip in batch]):
            named = trainer.objective.named_parameters()
            gradient = gradient or {name: tensor.grad.clone() for name, tensor in named if tensor.grad is not None}
            steps.append((step.losses, step.gradient_norm, step.num_frames))
    state = trainer.state_dict()
    return {"steps": steps, "gradient": gradient, "start": start, "end": parameters(trainer), "state": state}


def parameters(trainer: Trainer) -> dict[str, torch.Tensor]:
    return {name: tensor.detach().clone() for name, tensor in trainer.objective.named_parameters()}


if __name__ == "__main__":
    torch.set_num_threads(1)
    with join_processes("cpu") as group:
        for name in HISTORIES:
            torch.save(trained_steps(name, group), f"{sys.argv[1]}/{name}.{group.rank}")
