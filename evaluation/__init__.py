"""The nuScenes detection metrics and the IoU of map masks, in numpy."""

from .evaluation_report import ClassReport, EvaluationReport
from .evaluator import evaluate
from .sample import Sample

__all__ = ["ClassReport", "EvaluationReport", "Sample", "evaluate"]
