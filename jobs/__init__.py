"""Whole jobs as functions: each does what a command of the command line does, without options and printing.

Progress and messages go to callbacks. PyTorch is only imported by the jobs that need it, when they are called.
"""

from .anchor_job import cluster_anchors
from .export_job import export_model
from .inference import run
from .inspection import inspect_bundle
from .parity_job import check_bundle_parity
from .rig_check import check_rig
from .scoring import evaluate_bundle
from .signing import sign_bundle, verify_bundle
from .training_job import train_model

__all__ = [
    "check_bundle_parity",
    "check_rig",
    "cluster_anchors",
    "evaluate_bundle",
    "export_model",
    "inspect_bundle",
    "run",
    "sign_bundle",
    "train_model",
    "verify_bundle",
]
