"""Whole jobs as functions: each does what a command of the command line does, without options and printing.

Progress and messages go to callbacks. PyTorch is only imported by the jobs that need it, when they are called.
The functions are imported on first use, so that each command only waits for its own imports. A module must therefore
not have the name of a function of this list: its import would replace the function.
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .anchor_job import cluster_anchors
    from .batch.batch_job import run_batch
    from .benchmarking.bench_job import bench_bundle
    from .comparison import compare
    from .export_job import export_model
    from .golden_check import check_golden_example
    from .golden_parity import check_golden_parity
    from .inference import run
    from .inspection import inspect_bundle
    from .parity_job import check_bundle_parity
    from .quantization import quantize_bundle
    from .rig_check import check_rig
    from .scoring import evaluate_bundle
    from .serving.triton_repository import package_triton
    from .signing import sign_bundle, verify_bundle
    from .submission_scoring import evaluate_submission
    from .synthetic_job import write_synthetic
    from .training.training_job import train_model
else:
    _MODULES = {
        "bench_bundle": "benchmarking.bench_job",
        "check_bundle_parity": "parity_job",
        "check_golden_example": "golden_check",
        "check_golden_parity": "golden_parity",
        "check_rig": "rig_check",
        "cluster_anchors": "anchor_job",
        "compare": "comparison",
        "evaluate_bundle": "scoring",
        "evaluate_submission": "submission_scoring",
        "export_model": "export_job",
        "inspect_bundle": "inspection",
        "package_triton": "serving.triton_repository",
        "quantize_bundle": "quantization",
        "run": "inference",
        "run_batch": "batch.batch_job",
        "sign_bundle": "signing",
        "train_model": "training.training_job",
        "verify_bundle": "signing",
        "write_synthetic": "synthetic_job",
    }

    def __getattr__(name):
        if name not in _MODULES:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        return getattr(import_module(f".{_MODULES[name]}", __name__), name)


__all__ = [
    "bench_bundle",
    "check_bundle_parity",
    "check_golden_example",
    "check_golden_parity",
    "check_rig",
    "cluster_anchors",
    "compare",
    "evaluate_bundle",
    "evaluate_submission",
    "export_model",
    "inspect_bundle",
    "package_triton",
    "quantize_bundle",
    "run",
    "run_batch",
    "sign_bundle",
    "train_model",
    "verify_bundle",
    "write_synthetic",
]
