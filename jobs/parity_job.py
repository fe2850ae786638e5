"""The parity check of a bundle: its model is built again, and both run side by side."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..runtime.bundle.manifest import WeightsRecord, read_manifest
from ..runtime.bundle.parity_report import ParityReport
from ..runtime.extras import needs_extra
from ..runtime.progress import Progress, no_progress
from .models import build_model, bundle_config, optional_path, random_init_options
from .notify import Notify, ignore
from .sources import open_source

if TYPE_CHECKING:
    from ..export import Bisection


@dataclass(frozen=True)
class BundleParity:
    """The result of a parity check. bisection: None unless it was requested."""

    report: ParityReport
    bisection: "Bisection | None" = None

    def to_dict(self) -> dict[str, Any]:
        """The report and the bisection as JSON values."""
        bisection = {"bisection": self.bisection.to_dict()} if self.bisection else {}
        return self.report.model_dump(mode="json") | bisection


def check_bundle_parity(
    bundle: str | Path,
    *,
    weights: str | Path | None = None,
    random_weights: bool = False,
    seed: int | None = None,
    allow_missing: Sequence[str] | None = None,
    anchors: str | Path | None = None,
    source: str | Path | None = None,
    bisect: bool = False,
    progress: Progress = no_progress,
    notify: Notify = ignore,
) -> BundleParity:
    """Run a bundle and its model in PyTorch side by side, and compare their outputs.

    weights, random_weights: the checkpoint that the bundle was exported from, or random weights from `seed`.
    seed, allow_missing: None uses the values that the bundle records for its checkpoint.
    anchors: the file of anchors that the bundle was exported with.
    source: frames to compare on; None uses the stress sequence.
    bisect: find the first tensor that differs.
    Raises ArtifactError for a bundle or checkpoint that is not valid.
    """
    bundle, weights, anchors = Path(bundle), optional_path(weights), optional_path(anchors)
    manifest = read_manifest(bundle)
    with needs_extra("export"):
        from ..export import bisect_parity, check_parity
    config = bundle_config(bundle, manifest)
    recorded = manifest.weights.checkpoint if weights is not None else None
    seed, patterns = random_init_options(recorded, seed, list(allow_missing or []))
    model, provenance = build_model(config, weights, random_weights, seed, patterns, anchors)
    if provenance.sha256 != manifest.weights.sha256:
        notify(
            f"warning: the bundle was made from other weights, {_describe_weights(manifest.weights)}; "
            f"got {_describe_weights(provenance)}"
        )
    if source is None:
        frames, result = None, check_parity(bundle, model, progress=progress)
    else:
        frames = list(progress(open_source(source), "reading"))
        result = check_parity(bundle, model, frames, str(source), progress)
    bisection = bisect_parity(bundle, model, frames, result, progress) if bisect else None
    return BundleParity(result.to_report(), bisection)


def _describe_weights(weights: WeightsRecord) -> str:
    anchors = weights.anchors
    start = f", queries from {anchors.file} ({anchors.sha256[:12]})" if anchors else ", without --anchors"
    return f"{weights.source} ({weights.sha256[:12]}){start}"
