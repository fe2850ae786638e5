"""Export: a model becomes a bundle that is proven before anyone can see it."""

import shutil
import tempfile
from pathlib import Path

from ..model import DuoSpaceNet
from ..runtime.bundle.manifest import DeformableForm, Manifest, WeightsRecord, sha256, write_manifest
from ..runtime.errors import ArtifactError, CheckError, OutputError
from ..runtime.progress import Progress, no_progress
from ..weights.provenance import hash_weights
from .graphs import Graph, build_graphs
from .manifest_builder import graph_file, manifest
from .parity.check import ParityResult, check_parity
from .tracing import trace


class ParityError(CheckError):
    """The exported graphs are not equal to the model; nothing was written. Carries the report."""

    def __init__(self, report: ParityResult) -> None:
        lines = "\n".join(f"  {line}" for line in report.failures)
        super().__init__(f"the exported graphs differ from the model; no bundle was written:\n{lines}")
        self.report = report


def export_bundle(
    model: DuoSpaceNet,
    out: str | Path,
    weights: WeightsRecord | None = None,
    progress: Progress = no_progress,
    dcn: DeformableForm = "native",
) -> ParityResult:
    """Trace `model`, prove the graphs on the scripted drive, and only then let the bundle appear at `out`.

    weights: where the model's weights came from; None records their hash alone. dcn: the form of deformable
    convolutions, where the model has them.
    Raises OutputError when `out` exists or cannot be made, ArtifactError for a model that holds a NaN or Inf, and
    ParityError when the proof fails; nothing is left behind then, nor by an interruption.
    """
    out = Path(out)
    check_free(out)
    check_finite(model)
    model = model.eval()
    staging_dir = _make_staging_dir(out)
    try:
        graphs = build_graphs(model)
        for graph in progress(graphs, "export"):
            trace(graph, staging_dir / graph_file(graph.name), dcn)
        contract = _contract(staging_dir, model, graphs, weights, dcn)
        write_manifest(staging_dir, contract)
        report = check_parity(staging_dir, model, progress=progress)
        if not report.passed:
            raise ParityError(report)
        write_manifest(staging_dir, contract.model_copy(update={"parity": report.to_report()}))
        staging_dir.chmod(0o755)
        staging_dir.rename(out)
    finally:
        shutil.rmtree(staging_dir, ignore_errors=True)
    return report


def check_free(out: Path) -> None:
    """Raises OutputError when something stands at `out`."""
    if out.exists():
        raise OutputError(f"{out}: expected a new folder; it exists already. Remove it, or choose another --out.")


def check_finite(model: DuoSpaceNet) -> None:
    """Raises ArtifactError, naming the tensor, for a NaN or Inf in a parameter or buffer, saved with it or not."""
    tensors = [*model.named_parameters(), *model.named_buffers()]
    broken = [name for name, tensor in tensors if not bool(tensor.isfinite().all())]
    if broken:
        raise ArtifactError(
            f"the model's weights: expected finite numbers; got NaN or Inf in {len(broken)} tensors, the first "
            f"{broken[0]}. Nothing was exported."
        )


def _make_staging_dir(out: Path) -> Path:
    """A hidden folder beside `out`, so that the finished bundle takes its name by a single rename."""
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        return Path(tempfile.mkdtemp(prefix=f".{out.name}.", dir=out.parent))
    except OSError as error:
        raise OutputError(f"{out}: cannot be written ({error.strerror}). Choose another --out.") from error


def _contract(
    folder: Path, model: DuoSpaceNet, graphs: list[Graph], weights: WeightsRecord | None, dcn: DeformableForm
) -> Manifest:
    weights = weights or WeightsRecord(source="a model in memory", sha256=hash_weights(model), trained=None)
    digests = {graph.name: sha256(folder / graph_file(graph.name)) for graph in graphs}
    return manifest(model.config, weights, graphs, digests, dcn)
