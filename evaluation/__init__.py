"""How good the answers are: the nuScenes detection metrics and the IoU of maps, in numpy."""

from .evaluation_report import ClassReport, EvaluationReport
from .evaluator import evaluate
from .sample import Sample

__all__ = ["ClassReport", "Report", "Sample", "evaluate"]
