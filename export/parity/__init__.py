"""Parity: compare a bundle with the PyTorch model: its manifest, its weights, each graph, and the stream.

Start reading in `check.py`, which lists the checks.
"""

from .check import ParityResult, check_parity

__all__ = ["ParityResult", "check_parity"]
