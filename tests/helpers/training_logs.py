"""Logs of trainings: their lines without what differs between two runs of the same training."""

import json
from pathlib import Path
from typing import Any

MEASURED = {"step_s", "waiting_s", "frames_per_s", "remaining_s", "memory_gb", "gpu_memory_gb"}


def read_lines(out: Path) -> list[dict[str, Any]]:
    """The lines of the log in a training folder."""
    return [json.loads(line) for line in (out / "log.jsonl").read_text().splitlines()]


def reproducible_lines(out: Path) -> list[dict[str, Any]]:
    """The same lines without times, rates and memory."""
    return [{name: value for name, value in line.items() if name not in MEASURED} for line in read_lines(out)]
