"""How a model becomes graphs, and how they are proven equal to it."""

from .bundle import ParityError, export_bundle
from .parity import ParityReport, check_parity

__all__ = ["ParityError", "ParityReport", "check_parity", "export_bundle"]
