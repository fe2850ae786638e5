"""The options that say which model is meant: a preset or a bundle's configuration, and its weights."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from ..data.anchors_file import read_anchors
from ..runtime.bundle.manifest import MANIFEST_NAME, AnchorsFileRecord, Manifest, sha256
from ..runtime.errors import ArtifactError, UsageError
from ..runtime.extras import needs_extra
from ..runtime.json_record import describe_first_error

if TYPE_CHECKING:
    from ..model import DuoSpaceNet, DuoSpaceNetConfig
    from ..runtime.bundle.manifest import CheckpointRecord, WeightsRecord
    from ..weights import CheckpointReport


def find_preset(name: str) -> "DuoSpaceNetConfig":
    """The configuration of a preset. Raises UsageError for an unknown one."""
    with needs_extra("export"):
        from ..model.presets import ABLATIONS, PRESETS
    if name not in PRESETS:
        whole = [preset for preset in PRESETS if "-" not in preset]
        rows = ", ".join(f"-{row}" for row in ABLATIONS)
        raise UsageError(
            f"--preset: expected one of {', '.join(whole)}, or tiny, nano or small with one of {rows} behind it; "
            f"got {name!r}."
        )
    return PRESETS[name]


def bundle_config(bundle: Path, manifest: Manifest) -> "DuoSpaceNetConfig":
    """The configuration of a bundle's model. Raises ArtifactError where it is none of this toolkit."""
    with needs_extra("export"):
        from ..model import DuoSpaceNetConfig
    try:
        return DuoSpaceNetConfig.from_dict(manifest.config)
    except ValidationError as error:
        raise ArtifactError(
            f"{bundle / MANIFEST_NAME}: field config.{describe_first_error(error)}. It is of another toolkit: export again."
        ) from None


def build_model(
    config: "DuoSpaceNetConfig",
    weights: Path | None,
    random_weights: bool,
    seed: int,
    allow_missing: Sequence[str] | None = None,
    anchors: Path | None = None,
) -> tuple["DuoSpaceNet", "WeightsRecord"]:
    """A model with the weights that were asked for, and their provenance.

    anchors: a file of them for the queries' poses, where the weights have none.
    Raises UsageError unless exactly one kind was asked for, ArtifactError for a checkpoint or anchors that do not fit.
    """
    if (weights is not None) == random_weights:
        raise UsageError("weights: expected either --weights FILE or --random-weights; got both or neither.")
    if allow_missing and weights is None:
        raise UsageError("--allow-missing: expected with --weights FILE alone; got --random-weights.")
    with needs_extra("export"):
        from ..model import DuoSpaceNet, randomise
        from ..weights.provenance import file_weights
        from ..weights.provenance import random_weights as drawn_weights
    centres = None if anchors is None else _read_centres(anchors, config)
    model = DuoSpaceNet(config)
    if weights is None or allow_missing:
        randomise(model, seed)
    if weights is None:
        _place(model, centres)
        return model, _with_anchors(drawn_weights(model, seed), anchors)
    report = load_weights(model, weights, allow_missing)
    if anchors is not None and "queries.pose" in report.matched:
        raise UsageError(
            f"--anchors: expected weights without queries.pose; {weights.name} has them, and anchors would undo what "
            "they learned. Leave --anchors out."
        )
    _place(model, centres)
    return model, _with_anchors(file_weights(model, weights, report, seed), anchors)


def load_weights(model: "DuoSpaceNet", weights: Path, allow_missing: Sequence[str] | None) -> "CheckpointReport":
    """Load a checkpoint into a model; returns what became of every tensor. Raises ArtifactError for a misfit."""
    from ..weights import load_checkpoint

    with _as_artifact():
        return load_checkpoint(weights, model, allow_missing or ())


def random_init_options(
    recorded: "CheckpointRecord | None", seed: int | None = None, allow_missing: list[str] | None = None
) -> tuple[int, list[str]]:
    """The seed and the patterns of what a checkpoint lacks: those asked for, or else those the bundle was made with."""
    if recorded is None:
        return seed or 0, allow_missing or []
    patterns = dict.fromkeys(recorded.missing.values())
    return (recorded.seed or 0) if seed is None else seed, allow_missing or list(patterns)


def survey_weights(
    config: "DuoSpaceNetConfig", weights: Path, allow_missing: Sequence[str] | None
) -> "CheckpointReport":
    """How a checkpoint fits a configuration, without loading it. Raises ArtifactError where it cannot be read."""
    with needs_extra("export"):
        import torch

        from ..model import DuoSpaceNet
        from ..weights import read_checkpoint
    with torch.device("meta"):
        model = DuoSpaceNet(config)
    with _as_artifact():
        return read_checkpoint(weights, model, allow_missing or ()).report


def _read_centres(path: Path, config: "DuoSpaceNetConfig") -> NDArray[np.float64]:
    """The centres (Q, 3) [m] of a file of anchors. Raises ArtifactError unless there is one a query."""
    centres = read_anchors(path).centres
    if len(centres) != config.num_queries:
        raise ArtifactError(
            f"{path}: expected {config.num_queries} anchors, the queries of {config.preset}; got {len(centres)}. "
            f"Make them with `duospacenet anchors --queries {config.num_queries}`."
        )
    return centres


def _place(model: "DuoSpaceNet", centres: NDArray[np.float64] | None) -> None:
    import torch

    from ..model.queries import place_anchors

    if centres is not None:
        place_anchors(model.queries.pose, torch.from_numpy(centres))


def _with_anchors(provenance: "WeightsRecord", path: Path | None) -> "WeightsRecord":
    if path is None:
        return provenance
    return provenance.model_copy(update={"anchors": AnchorsFileRecord(file=path.name, sha256=sha256(path))})


@contextmanager
def _as_artifact() -> Iterator[None]:
    """Around reading a checkpoint: its failures end the command as a bad artifact."""
    from ..weights import CheckpointError

    try:
        yield
    except CheckpointError as error:
        advice = "" if error.report is None else " `duospacenet export --dry-run` prints the whole report."
        raise ArtifactError(f"{error}{advice}") from error
    except FileNotFoundError as error:
        raise ArtifactError(str(error)) from error
