"""Parity without PyTorch: a bundle, or the outputs of another engine, against the values of a golden file."""

from collections.abc import Collection
from pathlib import Path

from ..runtime import Pipeline
from ..runtime.bundle.bundle_files import read_graphs
from ..runtime.bundle.manifest import GraphName, Manifest, read_manifest
from ..runtime.engine import choose_engine
from ..runtime.parity.engine_log import outputs_in_log, read_engine_log
from ..runtime.parity.golden_file import GoldenFile
from ..runtime.parity.golden_parity import GoldenParity, engine_outputs
from ..runtime.progress import Progress, no_progress
from .models import optional_path
from .parity_job import BundleParity


def check_golden_parity(
    bundle: str | Path,
    golden: str | Path,
    *,
    engine: str = "onnxruntime",
    engine_log: str | Path | None = None,
    progress: Progress = no_progress,
) -> BundleParity:
    """Compare a bundle with the values of eager PyTorch in a golden file. PyTorch is not needed.

    golden: a file that `export --golden` wrote.
    engine: the library that runs the graphs, as for `check_bundle_parity`.
    engine_log: outputs that another engine computed from the golden file, in place of running the graphs. Then only
        single graphs are compared.
    Raises ArtifactError for a damaged bundle or golden file, and for those of different models. Raises InputError for a
    log that does not fit.
    """
    bundle, log = Path(bundle), optional_path(engine_log)
    choose_engine(engine)
    manifest = read_manifest(bundle)
    with GoldenFile(Path(golden)) as golden_file:
        golden_file.check_model(bundle, manifest)
        parity = GoldenParity(golden_file, manifest, _quantized_graphs(bundle, manifest))
        if log is not None:
            outputs = read_engine_log(log, golden_file, manifest, parity.compared_cases())
            parity.add_cases(outputs_in_log(outputs), progress)
            return BundleParity(parity.to_report(), f"outputs in {log.name}")
        pipeline = Pipeline.load(bundle, require_parity=False, engine=engine)
        parity.add_cases(engine_outputs(golden_file, pipeline), progress)
        parity.add_stream(pipeline, progress)
        return BundleParity(parity.to_report(), engine)


def _quantized_graphs(bundle: Path, manifest: Manifest) -> Collection[GraphName]:
    if manifest.precision == "float32":
        return ()
    return {name for name, content in read_graphs(bundle, manifest).items() if b"QuantizeLinear" in content}
