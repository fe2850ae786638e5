"""Write a bundle: trace the graphs in a staging directory, check parity, then move the finished folder into place."""

import shutil
import tempfile
from pathlib import Path

from ..model import DuoSpaceNet
from ..runtime.bundle.manifest import (
    AttentionForm,
    DeformableForm,
    Manifest,
    WeightsRecord,
    graph_file_name,
    sha256,
    write_manifest,
)
from ..runtime.bundle.operators import DEFAULT_OPSET, check_opset
from ..runtime.errors import ArtifactError, CheckError, OutputError
from ..runtime.progress import Progress, no_progress
from ..weights.provenance import hash_weights
from .golden_example import write_golden_example
from .graphs import Graph, graphs_to_export
from .manifest_builder import build_manifest
from .operator_forms import OperatorForms
from .parity import ParityResult, check_parity
from .tracing import trace


class ParityError(CheckError):
    """The exported graphs differ from the model, so no bundle was written. `result` holds the measured errors."""

    def __init__(self, result: ParityResult) -> None:
        lines = "\n".join(f"  {line}" for line in result.failures)
        super().__init__(f"the exported graphs differ from the model; no bundle was written:\n{lines}")
        self.result = result


def export_bundle(
    model: DuoSpaceNet,
    out: str | Path,
    weights: WeightsRecord | None = None,
    progress: Progress = no_progress,
    dcn: DeformableForm = "native",
    attention: AttentionForm = "compact",
    opset: int = DEFAULT_OPSET,
) -> ParityResult:
    """Export `model` to a new bundle at `out` and return the result of its parity check.

    The bundle appears at `out` only after it has passed the parity check on the stress sequence.
    An error or an interruption leaves no files behind.

    model: is set to evaluation mode.
    out: the folder to create; its parent folders are created too.
    weights: provenance of the model's weights, for the manifest. None records only their hash.
    progress: shows the progress over the graphs and over the frames of the parity check.
    dcn: ONNX form of the deformable convolutions, if the model has any.
    attention: ONNX form of PV attention and of lifting.
    opset: version of ONNX's operator set, one of `OPSETS`.

    Raises UsageError for another version, OutputError if `out` exists or cannot be created, ArtifactError if the model
    holds a NaN or an infinity, and ParityError if the parity check fails.
    """
    out = Path(out)
    check_opset(opset)
    check_output_is_new(out)
    _check_weights_are_finite(model)
    model = model.eval()
    staging_dir = make_staging_dir(out)
    try:
        graphs, forms = graphs_to_export(model), OperatorForms(dcn, attention, opset)
        for graph in progress(graphs, "export"):
            trace(graph, staging_dir / graph_file_name(graph.name), forms)
        manifest = _manifest_of_staged_graphs(staging_dir, model, graphs, weights, forms)
        write_manifest(staging_dir, manifest)
        # The check loads the bundle as a user would, so it needs a manifest. The report is added afterwards.
        result = check_parity(staging_dir, model, progress=progress)
        if not result.passed:
            raise ParityError(result)
        golden = write_golden_example(staging_dir, model)
        write_manifest(staging_dir, manifest.model_copy(update={"parity": result.to_report(), "golden": golden}))
        # mkdtemp created a folder that only its owner can read.
        staging_dir.chmod(0o755)
        staging_dir.rename(out)
    finally:
        shutil.rmtree(staging_dir, ignore_errors=True)
    return result


def check_output_is_new(out: Path) -> None:
    """Raise OutputError if `out` exists."""
    if out.exists():
        raise OutputError(f"{out}: expected a new folder; it exists already. Remove it, or choose another --out.")


def _check_weights_are_finite(model: DuoSpaceNet) -> None:
    """Raise ArtifactError, naming the tensor, if a parameter or buffer holds a NaN or an infinity.

    This includes the buffers that a checkpoint does not save.
    """
    tensors = [*model.named_parameters(), *model.named_buffers()]
    nonfinite = [name for name, tensor in tensors if not bool(tensor.isfinite().all())]
    if nonfinite:
        raise ArtifactError(
            f"the model's weights: expected finite numbers; got NaN or Inf in {len(nonfinite)} tensors, the first "
            f"{nonfinite[0]}. Nothing was exported."
        )


def make_staging_dir(out: Path) -> Path:
    """Create a hidden folder next to `out`. It is on the same file system, so one rename finishes the bundle."""
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        return Path(tempfile.mkdtemp(prefix=f".{out.name}.", dir=out.parent))
    except OSError as error:
        raise OutputError(f"{out}: cannot be written ({error.strerror}). Choose another --out.") from error


def _manifest_of_staged_graphs(
    staging_dir: Path, model: DuoSpaceNet, graphs: list[Graph], weights: WeightsRecord | None, forms: OperatorForms
) -> Manifest:
    """The manifest of the graph files in `staging_dir`, still without a parity report."""
    weights = weights or WeightsRecord(source="a model in memory", sha256=hash_weights(model), trained=None)
    hashes = {graph.name: sha256(staging_dir / graph_file_name(graph.name)) for graph in graphs}
    return build_manifest(model.config, weights, graphs, hashes, forms)
