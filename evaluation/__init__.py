"""How good the answers are: the nuScenes detection metrics and the IoU of maps, in numpy."""

from .evaluator import evaluate
from .report import ClassReport, Report
from .sample import Sample

__all__ = ["ClassReport", "Report", "Sample", "evaluate"]
