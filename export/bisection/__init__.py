"""Bisection: find the first graph, and in it the first tensor, where a bundle differs from the PyTorch model."""

from .search import Bisection, bisect_parity

__all__ = ["Bisection", "bisect_parity"]
