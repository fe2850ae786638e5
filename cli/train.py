"""`duospacenet train`: train a model on synthetic scenes or on your own data."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from . import training_options as options
from .console import print_json, print_message, print_result, show_bar, show_progress
from .options import AllowMissingOption, ConfigOption, IgnoreOption, JsonOption, PresetOption, WeightsKeyOption


def train(
    out: options.OutOption,
    preset: PresetOption = None,
    config: ConfigOption = None,
    source: options.SourceOption = None,
    weights: options.InitialWeightsOption = None,
    allow_missing: AllowMissingOption = None,
    ignore: IgnoreOption = None,
    weights_key: WeightsKeyOption = None,
    anchors: options.AnchorsOption = None,
    recipe: options.RecipeOption = "cpu",
    assignments: options.SetOption = None,
    tasks: options.TasksOption = None,
    steps: options.StepsOption = None,
    epochs: options.EpochsOption = None,
    batch_size: options.BatchSizeOption = None,
    frames_per_clip: options.FramesPerClipOption = None,
    learning_rate: options.LearningRateOption = None,
    backbone_learning_rate: options.BackboneLearningRateOption = None,
    warmup_steps: options.WarmupStepsOption = None,
    grid_mask: options.GridMaskOption = None,
    auxiliary_matches: options.AuxiliaryMatchesOption = None,
    pretraining: options.PretrainingOption = None,
    denoising: options.DenoisingOption = None,
    pv_supervision: options.PvSupervisionOption = None,
    bev_supervision: options.BevSupervisionOption = None,
    amp: options.AmpOption = None,
    seed: options.SeedOption = None,
    device: options.DeviceOption = "auto",
    workers: options.WorkersOption = 1,
    accumulation_steps: options.AccumulationStepsOption = 1,
    activation_checkpointing: options.ActivationCheckpointingOption = False,
    save_every: options.SaveEveryOption = 200,
    validation: options.ValidationOption = None,
    validate_every: options.ValidateEveryOption = None,
    tensorboard: options.TensorboardOption = False,
    resume: options.ResumeOption = False,
    as_json: JsonOption = False,
) -> None:
    """Train a model. Ctrl-C keeps the last checkpoint; --resume continues from it.

    \b
    Example:
      duospacenet train --preset nano --out out/train --steps 20000
    """
    values: dict[str, Any] = {"tasks": tasks, "steps": steps, "epochs": epochs, "batch_size": batch_size, "seed": seed}
    values |= {"frames_per_clip": frames_per_clip, "learning_rate": learning_rate, "amp": amp}
    values |= {"backbone_learning_rate": backbone_learning_rate, "warmup_steps": warmup_steps, "grid_mask": grid_mask}
    values |= {"auxiliary_matches": auxiliary_matches, "pretraining": pretraining, "denoising": denoising}
    values |= {"pv_supervision": pv_supervision, "bev_supervision": bev_supervision}
    settings = (values, recipe, assignments or ())
    selection: dict[str, Any] = {"allow_missing": allow_missing, "ignore": ignore, "weights_key": weights_key}
    run_options: dict[str, Any] = {"device": device, "workers": workers, "save_every": save_every, "resume": resume}
    run_options |= {"accumulation_steps": accumulation_steps, "activation_checkpointing": activation_checkpointing}
    run_options |= {"validation": validation, "validate_every": validate_every, "tensorboard": tensorboard}
    run_options |= {"anchors": anchors}
    _train(out, preset, config, settings, source, weights, selection, run_options, as_json)


def _train(
    out: Path,
    preset: str | None,
    config: Path | None,
    settings: tuple[dict[str, Any], str, Sequence[str]],
    sources: list[str] | None,
    weights: Path | None,
    selection: dict[str, Any],
    run_options: dict[str, Any],
    as_json: bool,
) -> None:
    """Train, and print where the weights are."""
    from .. import jobs
    from ..jobs.models import choose_config
    from ..jobs.training.requested_settings import training_settings
    from ..jobs.training.training_processes import join_training_processes

    # All of the command, so that only one of several processes reports an error.
    with join_training_processes(run_options["device"]) as processes:
        summary = jobs.train_model(
            choose_config(preset, config, weights),
            training_settings(*settings),
            out,
            sources=sources,
            weights=weights,
            **selection,
            **run_options,
            progress=show_progress,
            step_progress=show_bar,
            notify=print_message,
        )
        if not processes.is_first:
            return
    if as_json:
        print_json(summary.to_dict())
    elif summary.loss is None:  # a finished training was resumed
        print_result(f"no step was left: {summary.weights} is complete", markup=False, soft_wrap=True)
    else:
        steps = "1 step" if summary.steps == 1 else f"{summary.steps} steps"
        print_result(f"wrote {summary.weights} after {steps}", markup=False, soft_wrap=True)
