"""The export of a model to a bundle: the model is built from a configuration and weights, then exported."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from ..runtime.bundle.manifest import AttentionForm, DeformableForm
from ..runtime.bundle.operators import DEFAULT_OPSET, check_opset
from ..runtime.bundle.parity_report import ParityReport
from ..runtime.errors import OutputError, UsageError
from ..runtime.extras import needs_extra
from ..runtime.files import output_errors
from ..runtime.progress import Progress, no_progress
from .checkpoint_summary import describe_checkpoint
from .models import build_model, notify_shards, optional_path, preset_or_config
from .notify import Notify
from .notify import ignore as ignore_message

if TYPE_CHECKING:
    from ..model import DuoSpaceNetConfig


def export_model(
    config: "DuoSpaceNetConfig | str",
    out: str | Path,
    *,
    weights: str | Path | None = None,
    random_weights: bool = False,
    seed: int = 0,
    allow_missing: Sequence[str] | None = None,
    ignore: Sequence[str] | None = None,
    weights_key: str | None = None,
    anchors: str | Path | None = None,
    dcn: DeformableForm = "native",
    attention: AttentionForm = "compact",
    opset: int = DEFAULT_OPSET,
    golden: str | Path | None = None,
    progress: Progress = no_progress,
    notify: Notify = ignore_message,
) -> ParityReport:
    """Export a model to the new folder `out`, after checking that its graphs are equal to the model.

    config: the name of a preset, such as "tiny", or your own configuration.
    weights, random_weights: a checkpoint, or random weights from `seed`; exactly one of them.
    allow_missing: patterns of tensors that the checkpoint may lack; they are randomly initialised from `seed`.
    ignore: patterns of tensors in the checkpoint that are not loaded, such as a neck that does not fit.
    weights_key: the key of the weights in the checkpoint, if it holds several copies.
    anchors: a file of anchors for the query poses, for weights without poses.
    dcn: the form of deformable convolutions in the graphs.
    attention: the form of PV attention and of lifting in the graphs.
    opset: the version of ONNX's operator set in the graphs, 19 to 22.
    golden: also write this new golden file, with inputs and outputs of PyTorch for `check_golden_parity`.
    Raises ParityError, with the report, if the graphs differ; then no bundle is written. Raises OutputError if `out`
    or `golden` exists, ArtifactError for a checkpoint that does not fit, and UsageError for arguments that contradict
    each other.
    """
    config = preset_or_config(config)
    check_operators(config, dcn, opset)
    with needs_extra("export"):
        from ..export.bundle import check_output_is_new, export_bundle
    out, weights, anchors = Path(out), optional_path(weights), optional_path(anchors)
    check_output_is_new(out)
    golden_file = _check_golden_file(golden, out)
    if weights is not None:
        notify_shards(weights, notify)
    model, provenance = build_model(config, weights, random_weights, seed, allow_missing, anchors, ignore, weights_key)
    for line in describe_checkpoint(provenance.checkpoint) if provenance.checkpoint else ():
        notify(f"{provenance.source}: {line}")
    report = export_bundle(model, out, provenance, progress, dcn, attention, opset).to_report()
    if golden_file is not None:
        from ..export.parity.golden_writer import write_golden_file

        write_golden_file(golden_file, model, progress)
    return report


def _check_golden_file(golden: str | Path | None, out: Path) -> Path | None:
    """Check that a golden file can be written beside the bundle `out`. Raises OutputError and UsageError."""
    path = optional_path(golden)
    if path is None:
        return None
    if path.suffix != ".npz" or path.resolve().is_relative_to(out.resolve()):
        raise UsageError(f"--golden: expected a file *.npz outside the bundle; got {path}. Choose another one.")
    if path.exists():
        raise OutputError(f"{path}: expected a new file; it exists already. Remove it, or choose another --golden.")
    with output_errors(path):
        path.parent.mkdir(parents=True, exist_ok=True)
    return path


def check_operators(config: "DuoSpaceNetConfig", dcn: DeformableForm, opset: int) -> None:
    """Check the version, and that `dcn` is only changed for a model with deformable convolutions. Raises UsageError."""
    check_opset(opset)
    if dcn != "native" and not config.is_deformable:
        raise UsageError(
            f"--dcn: expected a configuration with deformable convolutions; {config.preset} has none. Leave --dcn out."
        )
