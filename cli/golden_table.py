"""The result of running a bundle's golden example, as text."""

from ..jobs.golden_check import GoldenCheck
from ..runtime.printable import printable
from .console import print_result


def print_golden_check(check: GoldenCheck) -> None:
    """Print what was compared, and the first difference."""
    engine = " ".join(check.engine.values())
    if check.difference is not None:
        print_result(f"differs    {printable(check.difference)}", markup=False, soft_wrap=True)
        print_result(f"golden     example failed in {engine}", markup=False)
        return
    compared = f"{check.frames} frames, {check.tensors} tensors, {check.values} values"
    print_result(f"golden     example equal in {engine}: {compared}", markup=False)
