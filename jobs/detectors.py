"""What answers the frames of an evaluation: a bundle in onnxruntime, or its model in PyTorch."""

from pathlib import Path
from typing import Protocol

from ..cli.console import print_message
from ..runtime import Detections, Frame, Pipeline
from ..runtime.bundle.manifest import Manifest
from ..runtime.errors import UsageError
from ..runtime.extras import needs_extra
from .models import build_model, bundle_config, random_init_options


class Detector(Protocol):
    """A stream of one vehicle, as the runtime's is."""

    def reset(self) -> None: ...

    def step(self, frame: Frame) -> Detections: ...


def onnx_detector(bundle: Path, threads: int | None) -> Detector:
    """The bundle itself; it draws its maps too, where it has any. Raises ArtifactError."""
    pipeline = Pipeline.load(bundle, threads)
    return pipeline.stream(maps="segmenter" in pipeline.sessions)


def eager_detector(bundle: Path, manifest: Manifest, weights: Path, anchors: Path | None) -> Detector:
    """The model of the bundle in eager mode, with the weights of a checkpoint.

    What the bundle's own checkpoint was allowed to lack, this one may lack too; it is drawn from the same seed.
    Raises ArtifactError for a checkpoint that does not fit, MissingExtraError without torch.
    """
    seed, allow_missing = random_init_options(manifest.weights.checkpoint)
    model, provenance = build_model(bundle_config(bundle, manifest), weights, False, seed, allow_missing, anchors)
    if provenance.sha256 != manifest.weights.sha256:
        print_message(f"warning: the bundle was made from other weights than {weights.name}")
    with needs_extra("export"):
        from ..export.parity.eager_stream import EagerStream
    return EagerStream(model, manifest)


def check_options(eager: bool, weights: Path | None, anchors: Path | None, threads: int | None) -> None:
    """Raises UsageError for options that ask for both detectors, or for neither."""
    if eager and weights is None:
        raise UsageError("--eager: expected --weights FILE with it, for a bundle holds graphs; got none.")
    if eager and threads is not None:
        raise UsageError("--threads: expected without --eager, where torch decides (OMP_NUM_THREADS). Leave it out.")
    if not eager and (weights is not None or anchors is not None):
        raise UsageError("--weights, --anchors: expected with --eager alone; a bundle has its own. Add --eager.")
