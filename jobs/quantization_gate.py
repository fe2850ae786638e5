"""The gate of a quantization: the metrics that an int8 bundle may lose against its float32 bundle."""

from ..runtime.bundle.quantization_record import MetricsRecord

LARGEST_LOSS = 0.005  # of mAP, NDS and the IoU of each map class: half a point
SMALLEST_RATIO = 0.99  # of mAP, the rule of MLPerf Automotive


def losses(float32: MetricsRecord, int8: MetricsRecord) -> dict[str, float]:
    """What each metric loses; negative for a gain."""
    ious = {f"IoU of {name}": float32.map_iou[name] - int8.map_iou[name] for name in float32.map_iou}
    return {"mAP": float32.mAP - int8.mAP, "NDS": float32.NDS - int8.NDS, **ious}


def violations(float32: MetricsRecord, int8: MetricsRecord) -> dict[str, str]:
    """The limits that the int8 bundle breaks: a line of text by metric."""
    lines = {
        name: f"{name}: expected a loss of at most {LARGEST_LOSS:g}; got {loss:.4f}"
        for name, loss in losses(float32, int8).items()
        if not loss <= LARGEST_LOSS
    }
    if "mAP" not in lines and not int8.mAP >= SMALLEST_RATIO * float32.mAP:
        lines["mAP"] = f"mAP: expected at least {SMALLEST_RATIO:.0%} of {float32.mAP:.4f}; got {int8.mAP:.4f}"
    return lines
