"""The CPU that a figure was measured on. Print it beside every figure: machines differ in their instruction sets."""

import os
import platform
from dataclasses import dataclass
from pathlib import Path

from .cores import available_cores
from .printable import printable

# The instruction sets that decide how fast float32 and int8 graphs run in onnxruntime and OpenVINO.
INSTRUCTION_SETS = ("avx2", "avx512f", "avx512_vnni", "avx_vnni", "avx512_bf16", "amx_tile", "amx_int8", "amx_bf16")


@dataclass(frozen=True)
class Cpu:
    """The CPU of this machine.

    model: name as the kernel reports it, or the machine's architecture.
    instruction_sets: those of `INSTRUCTION_SETS` that it has. Empty on systems without /proc/cpuinfo.
    cores: number of cores that this process may use, by affinity and quotas.
    affinity: numbers of the cores that the scheduler may choose; empty where the system does not say.
    """

    model: str
    instruction_sets: tuple[str, ...]
    cores: int
    affinity: tuple[int, ...]


def read_cpu(root: Path = Path("/")) -> Cpu:
    """Read the CPU of this machine. root: the folder that contains /proc and /sys."""
    fields: dict[str, str] = {}
    try:
        lines = (root / "proc/cpuinfo").read_text(errors="replace").splitlines()
    except OSError:
        lines = []
    for line in lines:
        name, _, value = line.partition(":")
        fields.setdefault(name.strip(), value.strip())
    flags = set(fields.get("flags", "").split())
    affinity = sorted(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else []
    return Cpu(
        model=printable(fields.get("model name") or platform.machine()),
        instruction_sets=tuple(name for name in INSTRUCTION_SETS if name in flags),
        cores=available_cores(root),
        affinity=tuple(affinity),
    )


def describe_cpu() -> str:
    """One line: model name, number of cores that this process may use, and instruction sets."""
    cpu = read_cpu()
    sets = " ".join(cpu.instruction_sets) or f"none of {' '.join(INSTRUCTION_SETS)}"
    return f"{cpu.model}, {cpu.cores} cores, {sets}"
