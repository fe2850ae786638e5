"""`duospacenet train`: train a model on synthetic scenes or on your own data."""

from pathlib import Path
from typing import Any

from . import training_options as options
from .console import print_json, print_message, print_result, show_progress
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
    steps: options.StepsOption = 10_000,
    batch_size: options.BatchSizeOption = 2,
    frames_per_clip: options.FramesPerClipOption = 6,
    learning_rate: options.LearningRateOption = 4e-4,
    backbone_learning_rate: options.BackboneLearningRateOption = None,
    warmup_steps: options.WarmupStepsOption = 200,
    grid_mask: options.GridMaskOption = 0.0,
    auxiliary_matches: options.AuxiliaryMatchesOption = 3,
    pretraining: options.PretrainingOption = False,
    denoising: options.DenoisingOption = 1,
    pv_supervision: options.PvSupervisionOption = True,
    bev_supervision: options.BevSupervisionOption = True,
    amp: options.AmpOption = "bfloat16",
    seed: options.SeedOption = 0,
    device: options.DeviceOption = "auto",
    workers: options.WorkersOption = 1,
    save_every: options.SaveEveryOption = 200,
    resume: options.ResumeOption = False,
    as_json: JsonOption = False,
) -> None:
    """Train a model as the paper does. Ctrl-C keeps the last checkpoint; --resume continues from it.

    \b
    Example:
      duospacenet train --preset nano --out out/train --steps 20000
    """
    settings: dict[str, Any] = {"steps": steps, "batch_size": batch_size, "frames_per_clip": frames_per_clip}
    settings |= {"learning_rate": learning_rate, "backbone_learning_rate": backbone_learning_rate, "amp": amp}
    settings |= {"warmup_steps": warmup_steps, "grid_mask": grid_mask, "pretraining": pretraining, "seed": seed}
    settings |= {"auxiliary_matches": auxiliary_matches, "denoising": denoising, "pv_supervision": pv_supervision}
    settings |= {"bev_supervision": bev_supervision}
    selection: dict[str, Any] = {"allow_missing": allow_missing, "ignore": ignore, "weights_key": weights_key}
    _train(out, preset, config, settings, source, weights, selection, device, workers, save_every, resume, as_json)


def _train(
    out: Path,
    preset: str | None,
    config: Path | None,
    settings: dict[str, Any],
    sources: list[str] | None,
    weights: Path | None,
    selection: dict[str, Any],
    device: str,
    workers: int,
    save_every: int,
    resume: bool,
    as_json: bool,
) -> None:
    """Train, and print where the weights are."""
    from .. import jobs
    from ..jobs.models import choose_config
    from ..jobs.training.requested_settings import training_settings

    summary = jobs.train_model(
        choose_config(preset, config, weights),
        training_settings(settings),
        out,
        sources=sources,
        weights=weights,
        **selection,
        device=device,
        workers=workers,
        save_every=save_every,
        resume=resume,
        progress=show_progress,
        notify=print_message,
    )
    if as_json:
        print_json(summary.to_dict())
    else:
        print_result(f"wrote {summary.weights} after {summary.steps} steps", markup=False, soft_wrap=True)
