"""Parity: compare a bundle with the PyTorch model on a stress sequence, graph by graph and as a stream."""

from .check import ParityResult, check_parity

__all__ = ["ParityResult", "check_parity"]
