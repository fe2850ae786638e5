"""The CPU that a figure was measured on. Print it beside every figure: machines differ in their instruction sets."""

import platform
from pathlib import Path

from duospacenet.runtime.cores import available_cores

# The instruction sets that decide how fast float32 and int8 graphs run in onnxruntime and OpenVINO.
INSTRUCTION_SETS = ("avx2", "avx512f", "avx512_vnni", "avx_vnni", "avx512_bf16", "amx_tile", "amx_int8", "amx_bf16")


def describe_cpu() -> str:
    """One line: model name, number of cores that this process may use, and instruction sets."""
    fields: dict[str, str] = {}
    for line in Path("/proc/cpuinfo").read_text().splitlines():
        name, _, value = line.partition(":")
        fields.setdefault(name.strip(), value.strip())
    model = fields.get("model name", platform.machine())
    flags = set(fields.get("flags", "").split())
    found = [name for name in INSTRUCTION_SETS if name in flags]
    return f"{model}, {available_cores()} cores, {' '.join(found) or 'none of ' + ' '.join(INSTRUCTION_SETS)}"
