"""The detectors of an evaluation: a bundle, or the bundle's model in PyTorch."""

from pathlib import Path
from typing import Protocol

from ..runtime import Detections, Frame
from ..runtime.bundle.manifest import Manifest
from ..runtime.engine import Engine
from ..runtime.errors import UsageError
from ..runtime.extras import needs_extra
from .models import build_model, bundle_config, random_init_options, recorded_selection
from .notify import Notify, ignore


class Detector(Protocol):
    """A stream of one vehicle, such as the runtime's `Stream`."""

    def reset(self) -> None:
        """Drop the history of frames."""

    def step(self, frame: Frame) -> Detections:
        """Detect the objects of the next frame."""


def eager_detector(
    bundle: Path, manifest: Manifest, weights: Path, anchors: Path | None = None, notify: Notify = ignore
) -> Detector:
    """The bundle's model in PyTorch eager mode, with the weights of a checkpoint.

    Tensors that the bundle's own checkpoint was allowed to lack may be missing here too. They are initialised from
    the same seed.
    Raises ArtifactError for a checkpoint that does not fit, MissingExtraError without torch.
    """
    seed, allow_missing = random_init_options(manifest.weights.checkpoint)
    config, selection = bundle_config(bundle, manifest), recorded_selection(manifest.weights.checkpoint)
    for name, value in selection.items():
        if value:
            notify(f"{weights.name}: read with --{name.replace('_', '-')} {value}, as the bundle records")
    model, provenance = build_model(config, weights, False, seed, allow_missing, anchors, **selection)
    if provenance.sha256 != manifest.weights.sha256:
        notify(f"warning: the bundle was made from weights other than {weights.name}")
    with needs_extra("export"):
        from ..export.parity.eager_stream import EagerStream
    return EagerStream(model)


def check_detector_options(
    eager: bool, weights: Path | None, anchors: Path | None, threads: int | None, engine: Engine
) -> None:
    """Check that the options choose exactly one detector. Raises UsageError."""
    if eager and weights is None:
        raise UsageError("--eager: expected --weights FILE with it, because a bundle only holds graphs; got none.")
    if eager and threads is not None:
        raise UsageError(
            "--threads: expected only without --eager, because torch chooses its own threads (OMP_NUM_THREADS). "
            "Leave --threads out."
        )
    if eager and engine != Engine():
        raise UsageError(
            "--engine, --engine-precision: expected only without --eager, which runs the model in PyTorch. Leave both "
            "out."
        )
    if not eager and (weights is not None or anchors is not None):
        raise UsageError(
            "--weights, --anchors: expected only with --eager, because a bundle holds its own weights. Add --eager."
        )
