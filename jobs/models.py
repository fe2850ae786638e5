"""Choosing a model: its configuration, and the weights that it gets."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..data.anchors_file import read_anchors
from ..runtime.bundle.manifest import MANIFEST_NAME, AnchorsFileRecord, Manifest, sha256
from ..runtime.errors import ArtifactError, UsageError
from ..runtime.extras import needs_extra
from .config_file import read_config_file
from .notify import Notify
from .notify import ignore as ignore_message

if TYPE_CHECKING:
    from ..model import DuoSpaceNet, DuoSpaceNetConfig
    from ..runtime.bundle.manifest import CheckpointRecord, WeightsRecord
    from ..weights import CheckpointReport


def optional_path(path: str | Path | None) -> Path | None:
    """A path that may be given as text, or None."""
    return None if path is None else Path(path)


def choose_config(
    preset: str | None, config_file: Path | None = None, weights: Path | None = None
) -> "DuoSpaceNetConfig":
    """The configuration of a preset, of a configuration file, or of the metadata of trained weights.

    weights: a checkpoint; its metadata is read only if `preset` and `config_file` are both None.
    Raises UsageError if both are given or no configuration is found, InputError for a configuration file with a
    mistake, and ArtifactError for weights that cannot be read.
    """
    if preset is not None and config_file is not None:
        raise UsageError("expected either --preset or --config; got both. Leave one of them out.")
    if preset is not None:
        return find_preset(preset)
    if config_file is not None:
        return read_config_file(config_file)
    config = None if weights is None else config_in_weights(weights)
    if config is None:
        without = "" if weights is None else f", and {weights} contains no configuration"
        raise UsageError(f"expected --preset NAME or --config FILE; got neither{without}.")
    return config


def preset_or_config(config: "DuoSpaceNetConfig | str") -> "DuoSpaceNetConfig":
    """A configuration, or that of the preset with this name. Raises UsageError for an unknown name or another type."""
    with needs_extra("export"):
        from ..model import DuoSpaceNetConfig
    if isinstance(config, str):
        return find_preset(config)
    if not isinstance(config, DuoSpaceNetConfig):
        raise UsageError(f"config: expected a preset's name or a DuoSpaceNetConfig; got {type(config).__name__}.")
    return config


def find_preset(name: str) -> "DuoSpaceNetConfig":
    """The configuration of a preset. Raises UsageError for an unknown name."""
    with needs_extra("export"):
        from ..model.presets import ABLATIONS, PRESETS
    if name not in PRESETS:
        sizes = ", ".join(preset for preset in PRESETS if "-" not in preset)
        suffixes = ", ".join(f"-{row}" for row in ABLATIONS)
        raise UsageError(
            f"--preset: expected one of {sizes}; or tiny, nano or small followed by one of {suffixes}; got {name!r}."
        )
    return PRESETS[name]


def bundle_config(bundle: Path, manifest: Manifest) -> "DuoSpaceNetConfig":
    """The configuration of a bundle's model. Raises ArtifactError if this toolkit does not know one of its fields."""
    with needs_extra("export"):
        from ..model import DuoSpaceNetConfig
    try:
        return DuoSpaceNetConfig.from_dict(manifest.config)
    except ValueError as error:
        raise ArtifactError(
            f"{bundle / MANIFEST_NAME}: field config.{error}. "
            "Another version of this toolkit wrote the bundle: export it again."
        ) from None


def build_model(
    config: "DuoSpaceNetConfig",
    weights: Path | None,
    random_weights: bool,
    seed: int,
    allow_missing: Sequence[str] | None = None,
    anchors: Path | None = None,
    ignore: Sequence[str] | None = None,
    weights_key: str | None = None,
) -> tuple["DuoSpaceNet", "WeightsRecord"]:
    """Build a model with weights from a checkpoint or with random weights; return it with the weights' provenance.

    seed: of the random weights, or of the tensors that the checkpoint lacks.
    allow_missing: patterns of tensor names that the checkpoint may lack.
    anchors: a file with initial query positions, for weights without `queries.pose`.
    ignore: patterns of tensor names in the checkpoint that are not loaded.
    weights_key: the key of the weights in the checkpoint, if it holds several copies.
    Raises UsageError unless exactly one of `weights` and `random_weights` is given, and ArtifactError for a
    checkpoint or an anchors file that does not fit the configuration.
    """
    if (weights is not None) == random_weights:
        got = "both" if random_weights else "neither"
        raise UsageError(f"expected either --weights FILE or --random-weights; got {got}.")
    check_checkpoint_options(weights, allow_missing, ignore, weights_key)
    with needs_extra("export"):
        from ..model import DuoSpaceNet, randomise
        from ..weights.provenance import record_checkpoint_weights, record_random_weights
    centres = None if anchors is None else read_centres(anchors, config)
    model = DuoSpaceNet(config)
    if weights is None or allow_missing:
        randomise(model, seed)
    if weights is None:
        _place_queries(model, centres)
        return model, _with_anchors(record_random_weights(model, seed), anchors)
    report = load_weights(model, weights, allow_missing, ignore, weights_key)
    if anchors is not None and "queries.pose" in report.matched:
        raise UsageError(
            f"--anchors: expected weights without queries.pose; {weights.name} contains trained query positions, "
            "which anchors would overwrite. Leave --anchors out."
        )
    _place_queries(model, centres)
    return model, _with_anchors(record_checkpoint_weights(model, weights, report, seed, weights_key), anchors)


def check_checkpoint_options(
    weights: Path | None,
    allow_missing: Sequence[str] | None,
    ignore: Sequence[str] | None,
    weights_key: str | None,
) -> None:
    """Check that options on the tensors of a checkpoint are only given with one. Raises UsageError."""
    options = {"--allow-missing": allow_missing, "--ignore": ignore, "--weights-key": weights_key}
    for option, value in options.items():
        if value and weights is None:
            raise UsageError(f"{option}: expected only with --weights FILE; got none. Leave {option} out.")


def load_weights(
    model: "DuoSpaceNet",
    weights: Path,
    allow_missing: Sequence[str] | None = None,
    ignore: Sequence[str] | None = None,
    weights_key: str | None = None,
) -> "CheckpointReport":
    """Load a checkpoint into a model; return the report on every tensor. Raises ArtifactError if it does not fit."""
    from ..weights import load_checkpoint

    with checkpoint_errors():
        return load_checkpoint(weights, model, allow_missing or (), ignore or (), weights_key)


def load_starting_weights(
    model: "DuoSpaceNet",
    weights: Path,
    allow_missing: Sequence[str] | None = None,
    ignore: Sequence[str] | None = None,
    weights_key: str | None = None,
) -> "CheckpointReport":
    """Load the weights that a training starts from; return the report on every tensor.

    A checkpoint of another code base may hold a part of the model only, see `load_start`.
    Raises ArtifactError if it does not fit.
    """
    from ..weights.starting_checkpoint import load_start

    with checkpoint_errors():
        return load_start(weights, model, allow_missing or (), ignore or (), weights_key)


def random_init_options(
    recorded: "CheckpointRecord | None", seed: int | None = None, allow_missing: list[str] | None = None
) -> tuple[int, list[str]]:
    """The seed and the name patterns of tensors that are initialised at random because a checkpoint lacks them.

    recorded: the options that the bundle was exported with; `seed` and `allow_missing` override them if given.
    """
    if recorded is None:
        return seed or 0, allow_missing or []
    patterns = dict.fromkeys(recorded.missing.values())
    return (recorded.seed or 0) if seed is None else seed, allow_missing or list(patterns)


def recorded_selection(recorded: "CheckpointRecord | None") -> dict[str, Any]:
    """The arguments of `build_model` that select the tensors of a checkpoint as the bundle's export did."""
    if recorded is None:
        return {}
    return {"ignore": list(dict.fromkeys(recorded.ignored.values())), "weights_key": recorded.weights_key}


def report_checkpoint_fit(
    config: "DuoSpaceNetConfig",
    weights: Path,
    allow_missing: Sequence[str] | None,
    ignore: Sequence[str] | None = None,
    weights_key: str | None = None,
    notify: Notify = ignore_message,
) -> "CheckpointReport":
    """Report how a checkpoint fits a configuration, without loading it. Raises ArtifactError if it cannot be read."""
    with needs_extra("export"):
        import torch

        from ..model import DuoSpaceNet
        from ..weights import read_checkpoint
    with torch.device("meta"):
        model = DuoSpaceNet(config)
    notify_shards(weights, notify)
    with checkpoint_errors():
        return read_checkpoint(weights, model, allow_missing or (), ignore or (), weights_key).report


def notify_shards(weights: Path, notify: Notify) -> None:
    """Say how many files are read, if the checkpoint is sharded. Raises ArtifactError if a file is missing."""
    from ..weights.checkpoint_file import checkpoint_files

    with checkpoint_errors():
        files = checkpoint_files(weights)
    if len(files) > 1:
        notify(f"{weights}: reading {len(files) - 1} shards")


def config_in_weights(weights: Path) -> "DuoSpaceNetConfig | None":
    """The configuration in the metadata of a checkpoint, or None. Raises ArtifactError if it cannot be read."""
    with needs_extra("export"):
        from ..model import DuoSpaceNetConfig
        from ..weights import read_config
    with checkpoint_errors():
        values = read_config(weights)
    if values is None:
        return None
    try:
        return DuoSpaceNetConfig.from_dict(values)
    except ValueError as error:
        raise ArtifactError(
            f"{weights}: the configuration in its metadata: field {error}. Name one with --preset or --config."
        ) from None


def read_centres(path: Path, config: "DuoSpaceNetConfig") -> NDArray[np.float64]:
    """The centres (Q, 3) [m] in an anchors file. Raises ArtifactError unless there is one per query."""
    centres = read_anchors(path).centres
    if len(centres) != config.num_queries:
        raise ArtifactError(
            f"{path}: expected {config.num_queries} anchors, one per query of {config.preset}; got {len(centres)}. "
            f"Make them with `duospacenet anchors --queries {config.num_queries}`."
        )
    return centres


def _place_queries(model: "DuoSpaceNet", centres: NDArray[np.float64] | None) -> None:
    import torch

    from ..model.queries import place_anchors

    if centres is not None:
        place_anchors(model.queries.pose, torch.from_numpy(centres))


def _with_anchors(provenance: "WeightsRecord", path: Path | None) -> "WeightsRecord":
    if path is None:
        return provenance
    return provenance.model_copy(update={"anchors": AnchorsFileRecord(file=path.name, sha256=sha256(path))})


@contextmanager
def checkpoint_errors() -> Iterator[None]:
    """Turn the errors of reading a checkpoint into ArtifactError."""
    from ..weights import CheckpointError

    try:
        yield
    except CheckpointError as error:
        advice = "" if error.report is None else " `duospacenet export --dry-run` prints the whole report."
        raise ArtifactError(f"{error}{advice}") from error
    except (FileNotFoundError, PermissionError) as error:
        raise ArtifactError(str(error)) from error
