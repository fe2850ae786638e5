"""How a model becomes graphs, and how they are proven equal to it."""

from .bisection.search import Bisection, bisect_parity
from .bundle import ParityError, export_bundle
from .parity.check import ParityResult, check_parity

__all__ = ["Bisection", "ParityError", "ParityResult", "bisect_parity", "check_parity", "export_bundle"]
