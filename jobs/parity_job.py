"""The parity check of a bundle: its model is built again, and both run side by side."""

import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..runtime.bundle.manifest import CheckpointRecord, Manifest, WeightsRecord, read_manifest
from ..runtime.bundle.parity_report import ParityReport
from ..runtime.engine import choose_engine
from ..runtime.errors import UsageError
from ..runtime.extras import needs_extra
from ..runtime.progress import Progress, no_progress
from .models import (
    build_model,
    choose_config,
    config_in_weights,
    find_preset,
    optional_path,
    random_init_options,
    recorded_selection,
)
from .notify import Notify
from .notify import ignore as ignore_message
from .sources import SourceNames, open_sources, source_names

if TYPE_CHECKING:
    from ..export import Bisection
    from ..model import DuoSpaceNetConfig


@dataclass(frozen=True)
class BundleParity:
    """The result of a parity check.

    engine: the library that ran the graphs.
    bisection: None unless it was requested.
    """

    report: ParityReport
    engine: str
    bisection: "Bisection | None" = None

    def to_dict(self) -> dict[str, Any]:
        """The report and the bisection as JSON values."""
        bisection = {"bisection": self.bisection.to_dict()} if self.bisection else {}
        return self.report.model_dump(mode="json") | {"engine": self.engine} | bisection


def check_bundle_parity(
    bundle: str | Path,
    *,
    weights: str | Path | None = None,
    random_weights: bool = False,
    preset: str | None = None,
    config: str | Path | None = None,
    seed: int | None = None,
    allow_missing: Sequence[str] | None = None,
    ignore: Sequence[str] | None = None,
    weights_key: str | None = None,
    anchors: str | Path | None = None,
    sources: SourceNames | None = None,
    random_inputs: int = 12,
    retrace: bool = True,
    bisect: bool = False,
    engine: str = "onnxruntime",
    progress: Progress = no_progress,
    notify: Notify = ignore_message,
) -> BundleParity:
    """Compare a bundle with its model in PyTorch.

    weights, random_weights: the checkpoint that the bundle was exported from, or random weights from `seed`.
    preset, config: the model's configuration, by name or from a file. By default it is the one in the checkpoint's
        metadata, else the preset that the bundle names. It is never read from the bundle.
    seed, allow_missing: None uses the values that the bundle records for its checkpoint.
    ignore, weights_key: as for the export. They are never read from the bundle, which could hide a part of the
        checkpoint with them.
    anchors: the file of anchors that the bundle was exported with.
    sources: one or several sources of frames to compare on, after the stress sequence.
    random_inputs: number of random inputs of a graph.
    retrace: also compare the graphs with a new export, if the bundle was exported with the installed versions.
    bisect: find the first tensor that differs; only with onnxruntime.
    engine: the library that runs the graphs, "onnxruntime" or "openvino". It computes in float32.
    Raises ArtifactError for a bundle or checkpoint that is not valid.
    """
    _check_engine(engine, bisect)
    bundle, weights, anchors = Path(bundle), optional_path(weights), optional_path(anchors)
    manifest = read_manifest(bundle)
    if bisect and manifest.precision != "float32":
        raise UsageError(
            f"--bisect: expected a float32 bundle; got {manifest.precision}, whose tensors all differ a little. Bisect "
            "the float32 bundle that it was made from."
        )
    with needs_extra("export"):
        from ..export import bisect_parity, check_parity
    model_config = _reference_config(bundle, manifest, preset, optional_path(config), weights)
    recorded = manifest.weights.checkpoint if weights is not None else None
    seed, patterns = random_init_options(recorded, seed, list(allow_missing or []))
    for line in _unused_options(recorded, ignore, weights_key):
        notify(line)
    model, provenance = build_model(model_config, weights, random_weights, seed, patterns, anchors, ignore, weights_key)
    if provenance.sha256 != manifest.weights.sha256:
        notify(
            f"warning: the bundle was made from other weights, {_describe_weights(manifest.weights)}; "
            f"got {_describe_weights(provenance)}"
        )
    names = [] if sources is None else source_names(sources)
    frames = list(progress(open_sources(names, progress=progress), "reading")) if names else []
    options: dict[str, Any] = {"retrace": retrace, "engine": engine}
    result = check_parity(
        bundle, model, frames, ", ".join(map(str, names)), random_inputs, provenance, progress, **options
    )
    bisection = bisect_parity(bundle, model, frames, result, progress) if bisect else None
    return BundleParity(result.to_report(), engine, bisection)


def _check_engine(engine: str, bisect: bool) -> None:
    choose_engine(engine)
    if bisect and engine != "onnxruntime":
        raise UsageError(
            "--bisect: expected only with --engine onnxruntime, which can run a part of a graph without optimisations. "
            "Leave --engine out: a wrong graph file differs there too."
        )


def _unused_options(
    recorded: CheckpointRecord | None, ignore: Sequence[str] | None, weights_key: str | None
) -> list[str]:
    """A line for each option of the export that selects tensors of the checkpoint and was not given again."""
    options = recorded_selection(recorded)
    lines = []
    if options.get("ignore") and not ignore:
        patterns = " ".join(f"--ignore {shlex.quote(pattern)}" for pattern in options["ignore"])
        lines.append(f"the bundle was exported with {patterns}: give it again to leave the same tensors out")
    if options.get("weights_key") is not None and weights_key is None:
        key = shlex.quote(options["weights_key"])
        lines.append(f"the bundle was exported with --weights-key {key}: give it again to compare with the same copy")
    return lines


def _reference_config(
    bundle: Path, manifest: Manifest, preset: str | None, config: Path | None, weights: Path | None
) -> "DuoSpaceNetConfig":
    """The configuration of the reference. Of the bundle, only the name of its preset is used."""
    if preset is not None or config is not None:
        return choose_config(preset, config)
    if weights is not None and (found := config_in_weights(weights)) is not None:
        return found
    try:
        return find_preset(manifest.preset)
    except UsageError:
        raise UsageError(
            f"{bundle}: expected a bundle of a preset of this toolkit; got {manifest.preset!r}. "
            "Name the configuration that it was exported with: --config FILE."
        ) from None


def _describe_weights(weights: WeightsRecord) -> str:
    anchors = weights.anchors
    start = f", queries from {anchors.file} ({anchors.sha256[:12]})" if anchors else ", without --anchors"
    return f"{weights.source} ({weights.sha256[:12]}){start}"
