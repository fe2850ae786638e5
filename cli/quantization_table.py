"""The quantization record of an int8 bundle as text and tables."""

from math import nan

from rich import box
from rich.markup import escape
from rich.table import Table

from ..runtime.bundle.quantization_record import FramesRecord, QuantizationRecord
from ..runtime.printable import printable
from .console import print_result


def print_quantization(record: QuantizationRecord) -> None:
    """Print how a bundle was quantized, and what the rounding costs."""
    for name, fact in _facts(record).items():
        print_result(printable(f"{name:<16} {fact}"), markup=False, soft_wrap=True)
    print_result(_loss_table(record))


def _facts(record: QuantizationRecord) -> dict[str, str]:
    recipe = record.recipe
    return {
        "int8": f"activations {recipe.activations}, weights {recipe.weights}, {' '.join(recipe.operators)}, "
        f"{recipe.calibration}, by onnxruntime {recipe.onnxruntime}",
        "made from": f"the float32 bundle with manifest.json {record.float_manifest_sha256[:12]}",
        "calibrated on": _describe_frames(record.calibration),
        "compared on": _describe_frames(record.judging),
        "int8 blocks": ", ".join(record.quantized_blocks),
        "float32 blocks": ", ".join(record.float_blocks) or "none of those that can be quantized",
    }


def _describe_frames(frames: FramesRecord) -> str:
    return f"{frames.frames} frames: {', '.join(frames.sources)}"


def _loss_table(record: QuantizationRecord) -> Table:
    """The metrics and the agreement with float32. "simulated": rounded, but with float32 arithmetic."""
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False, collapse_padding=True)
    for column in ("", "float32", "simulated", "engine"):
        table.add_column(column, justify="right" if column else "left", no_wrap=True)
    for name, values in _metric_rows(record).items():
        table.add_row(escape(printable(name)), *values)
    for name, (float32, values) in _agreement_rows(record).items():
        table.add_row(escape(name), float32, *values)
    return table


def _metric_rows(record: QuantizationRecord) -> dict[str, list[str]]:
    metrics = record.metrics
    if metrics is None:
        return {}
    columns = [metrics.float32, metrics.simulated, metrics.engine]
    rows = {"mAP": [f"{column.mAP:.4f}" for column in columns], "NDS": [f"{column.NDS:.4f}" for column in columns]}
    ious = {
        f"IoU of {name}": [f"{column.map_iou.get(name, nan):.4f}" for column in columns] for name in columns[0].map_iou
    }
    return rows | ious


def _agreement_rows(record: QuantizationRecord) -> dict[str, tuple[str, list[str]]]:
    columns = [record.agreement.simulated, record.agreement.engine]
    return {
        "matched boxes": (f"{columns[0].boxes}", [f"{column.matched:.2%}" for column in columns]),
        "score difference": ("", [f"{column.score:.4f}" for column in columns]),
        "distance [m]": ("", [f"{column.position_m:.3f}" for column in columns]),
    }
