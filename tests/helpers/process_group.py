"""Two training processes, which join as if torchrun had started them."""

import os
import socket
import subprocess
import sys
from pathlib import Path

from tests.helpers.processes import popen

ROOT = Path(__file__).resolve().parents[2]
TIMEOUT_S = 240


def start_processes(arguments: list[str], count: int = 2) -> list[subprocess.Popen]:
    """Start `python -m ARGUMENTS` `count` times, with the environment of torchrun."""
    with socket.socket() as free:
        free.bind(("localhost", 0))
        port = free.getsockname()[1]
    group = {"TORCHELASTIC_RUN_ID": "test", "MASTER_ADDR": "localhost", "MASTER_PORT": str(port)}
    group |= {"WORLD_SIZE": str(count), "LOCAL_WORLD_SIZE": str(count), "OMP_NUM_THREADS": "1"}
    return [
        popen(
            [sys.executable, "-m", *arguments],
            cwd=ROOT,
            env={**os.environ, **group, "RANK": str(rank), "LOCAL_RANK": str(rank)},
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        for rank in range(count)
    ]


def wait_for_processes(processes: list[subprocess.Popen]) -> list[tuple[int, str, str]]:
    """The exit code, stdout and stderr of each process. No process outlives this call."""
    try:
        outputs = [process.communicate(timeout=TIMEOUT_S) for process in processes]
    finally:
        for process in processes:
            process.kill()
            process.wait()
    return [(process.returncode, *output) for process, output in zip(processes, outputs, strict=True)]
